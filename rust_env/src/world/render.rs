//! Depth images and ray casts of a triangle mesh, on the processor.
//!
//! Triangles are seen from both sides. One hierarchy ([`bvh`]) serves single rays ([`ray`]), packets of rays ([`packet`])
//! and the rasteriser ([`raster`]); each is compiled for AVX-512, AVX2 and portable code and chosen at run time ([`simd`]).
//! Bodies that move have hierarchies of their own and are drawn over the image ([`movable`]).
mod bvh;
mod movable;
mod packet;
mod raster;
mod ray;
mod simd;
mod view;

pub use movable::{Movable, Placed};
pub use simd::Isa;

use crate::camera::Camera;
use crate::geometry::{Mesh, Pose, Vec3};
use crate::world::bytes::{Fault, Reader, Writer};
use bvh::Bvh;
use std::cell::RefCell;

/// How an image is made; all give the same depths.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// One ray after the other.
    Rays,
    /// Rays in packets of 4 x 4.
    Packets,
    /// Triangles into a depth buffer.
    Raster,
}

/// What stays allocated between images and casts of a thread.
struct Scratch {
    todo: Vec<ray::Entry>,
    raster: raster::Scratch,
}

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::new(Scratch {
        todo: vec![ray::Entry::default(); bvh::STACK],
        raster: raster::Scratch::default(),
    });
}

/// An immutable mesh that cameras look at.
pub struct DepthRenderer {
    bvh: Bvh,
    triangles: usize,
    isa: Isa,
}

impl DepthRenderer {
    /// Triangles that name missing vertices or have coordinates that are not finite are left out; degenerate ones are
    /// harmless. About 1 microsecond per triangle.
    pub fn new(mesh: &Mesh) -> Self {
        Self::with_isa(mesh, Isa::best())
    }

    /// For tests and benchmarks: with the kernels of one instruction set (portable if the processor lacks it).
    pub fn with_isa(mesh: &Mesh, isa: Isa) -> Self {
        Self {
            bvh: Bvh::new(mesh),
            triangles: mesh.triangles.len(),
            isa,
        }
    }

    /// Writes the depth image, row by row, of the kind and with the limits that [`Camera`] describes.
    ///
    /// # Panics
    /// If `out` does not have `camera.pixels()` values.
    pub fn render(&self, camera: &Camera, world_from_camera: &Pose, out: &mut [f32]) {
        self.render_by(self.method(camera), camera, world_from_camera, out);
    }

    /// The method that is fastest for such an image, by the number of triangles for each pixel.
    ///
    /// Measured with `benches/render.rs` on furnished rooms of 31 k, 189 k and 1.03 M triangles, 64 x 48 to 640 x 480: with
    /// wide vectors the rasteriser leads at 61 triangles a pixel (10.2 Mrays/s; packets 9.6, single rays 6.6) and loses
    /// at 335 (1.7; 1.8; 5.2). Portable code leads with the rasteriser at 10 (12.8; 10.3; 3.5), with packets at 53
    /// (3.1; 4.7; 2.6) and with single rays at 335 (0.4; 0.9; 1.9).
    pub fn method(&self, camera: &Camera) -> Method {
        let density = self.triangles as f32 / camera.pixels() as f32;
        let (raster, packets) = match self.isa {
            Isa::Portable => (15.0, 100.0),
            Isa::Avx2 | Isa::Avx512 => (120.0, 120.0),
        };
        if density < raster {
            Method::Raster
        } else if density < packets {
            Method::Packets
        } else {
            Method::Rays
        }
    }

    /// For tests and benchmarks: with a method of choice.
    pub fn render_by(
        &self,
        method: Method,
        camera: &Camera,
        world_from_camera: &Pose,
        out: &mut [f32],
    ) {
        assert_eq!(out.len(), camera.pixels(), "size of the depth image");
        let view = &view::View::new(camera, world_from_camera);
        let bvh = &self.bvh;
        SCRATCH.with_borrow_mut(|scratch| match method {
            Method::Rays => {
                let todo = &mut scratch.todo[..];
                self.isa.run(ray::Rays {
                    bvh,
                    view,
                    todo,
                    out,
                });
            }
            Method::Packets => {
                let todo = &mut scratch.todo[..];
                self.isa.run(packet::Packets {
                    bvh,
                    view,
                    todo,
                    window: packet::Window::of(camera),
                    over: false,
                    out,
                });
            }
            Method::Raster => {
                let scratch = &mut scratch.raster;
                self.isa.run(raster::Raster {
                    bvh,
                    view,
                    scratch,
                    out,
                });
            }
        });
    }

    /// Distance in metres to the first surface along the unit vector `direction`, if nearer than `max_range`.
    /// A surface at the origin itself does not count.
    pub fn cast(&self, origin: Vec3, direction: Vec3, max_range: f32) -> Option<f32> {
        SCRATCH.with_borrow_mut(|scratch| {
            self.isa.run(ray::Cast {
                bvh: &self.bvh,
                origin,
                direction,
                limit: max_range,
                todo: &mut scratch.todo,
            })
        })
    }

    /// The kernels in use: they round differently, in the last bit.
    pub fn isa(&self) -> Isa {
        self.isa
    }

    /// The hierarchy, for a cache.
    pub fn write(&self, out: &mut Writer) {
        self.bvh.write(out);
    }

    /// A renderer of `mesh` with the hierarchy that [`DepthRenderer::write`] wrote. It is sound, but whether it is that of the
    /// mesh is for the cache's checksum to say.
    pub fn read(from: &mut Reader, mesh: &Mesh) -> Result<Self, Fault> {
        Ok(Self {
            bvh: Bvh::read(from)?,
            triangles: mesh.triangles.len(),
            isa: Isa::best(),
        })
    }

    /// Heap memory of the hierarchy.
    pub fn memory_bytes(&self) -> usize {
        self.bvh.memory_bytes()
    }
}

#[cfg(test)]
mod degenerate_tests;
#[cfg(test)]
mod tests;
