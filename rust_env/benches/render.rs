//! Depth images per instruction set, size and density: `cargo bench --bench render`. Throughput is in rays (pixels).
use criterion::{criterion_group, criterion_main, BenchmarkId, Criterion, Throughput};
use nbv_core::camera::Camera;
use nbv_core::geometry::{Mesh, Pose, Vec3};
use nbv_core::world::render::{DepthRenderer, Isa, Method};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::hint::black_box;

/// Four by three furnished rooms of 5 x 4.5 m, all surfaces bumpy and cut into cells of `cell` metres.
struct Apartment {
    mesh: Mesh,
    cell: f32,
    random: Pcg64Mcg,
}

const ROOM: Vec3 = Vec3::new(5.0, 4.5, 2.7);
const WALL: f32 = 0.12;

impl Apartment {
    fn build(cell: f32) -> Mesh {
        let mut a = Self {
            mesh: Mesh::default(),
            cell,
            random: Pcg64Mcg::seed_from_u64(7),
        };
        let (lx, ly) = (4.0 * ROOM.x, 3.0 * ROOM.y);
        a.cuboid([-WALL, -WALL, -0.1], [lx + WALL, ly + WALL, 0.0]);
        a.cuboid([-WALL, -WALL, ROOM.z], [lx + WALL, ly + WALL, ROOM.z + 0.1]);
        // Walls with doors of 0.95 m between rooms.
        for j in 0..=3 {
            for i in 0..4 {
                let (x, y) = (i as f32 * ROOM.x, j as f32 * ROOM.y);
                let door = if j == 0 || j == 3 {
                    ROOM.x
                } else {
                    a.uniform(1.0, 3.0)
                };
                a.cuboid([x, y - WALL, 0.0], [x + door, y + WALL, ROOM.z]);
                if door < ROOM.x {
                    a.cuboid(
                        [x + door + 0.95, y - WALL, 0.0],
                        [x + ROOM.x, y + WALL, ROOM.z],
                    );
                    a.cuboid(
                        [x + door, y - WALL, 2.05],
                        [x + door + 0.95, y + WALL, ROOM.z],
                    );
                }
            }
        }
        for i in 0..=4 {
            for j in 0..3 {
                let (x, y) = (i as f32 * ROOM.x, j as f32 * ROOM.y);
                let door = if i == 0 || i == 4 {
                    ROOM.y
                } else {
                    a.uniform(1.0, 2.5)
                };
                a.cuboid([x - WALL, y, 0.0], [x + WALL, y + door, ROOM.z]);
                if door < ROOM.y {
                    a.cuboid(
                        [x - WALL, y + door + 0.95, 0.0],
                        [x + WALL, y + ROOM.y, ROOM.z],
                    );
                    a.cuboid(
                        [x - WALL, y + door, 2.05],
                        [x + WALL, y + door + 0.95, ROOM.z],
                    );
                }
            }
        }
        a.cell *= 0.5;
        for i in 0..4 {
            for j in 0..3 {
                a.furnish(i as f32 * ROOM.x, j as f32 * ROOM.y);
            }
        }
        a.mesh
    }

    fn furnish(&mut self, ox: f32, oy: f32) {
        let (tx, ty) = (ox + self.uniform(1.2, 2.5), oy + self.uniform(1.2, 2.2));
        self.cuboid([tx, ty, 0.72], [tx + 1.4, ty + 0.8, 0.76]);
        for (x, y) in [(0.05, 0.05), (1.29, 0.05), (0.05, 0.69), (1.29, 0.69)] {
            self.cuboid([tx + x, ty + y, 0.0], [tx + x + 0.06, ty + y + 0.06, 0.72]);
        }
        for k in 0..4 {
            let cx = tx + 0.15 + 0.7 * (k % 2) as f32;
            let cy = if k < 2 { ty - 0.5 } else { ty + 0.9 };
            let back = if k < 2 { cy } else { cy + 0.38 };
            self.cuboid([cx, cy, 0.42], [cx + 0.42, cy + 0.42, 0.46]);
            self.cuboid([cx, back, 0.46], [cx + 0.42, back + 0.04, 0.95]);
            for (x, y) in [(0.0, 0.0), (0.38, 0.0), (0.0, 0.38), (0.38, 0.38)] {
                self.cuboid([cx + x, cy + y, 0.0], [cx + x + 0.04, cy + y + 0.04, 0.42]);
            }
        }
        // A shelf with books.
        let (sx, sy) = (ox + WALL + 0.02, oy + ROOM.y - 1.6);
        for k in 0..5 {
            let z = 0.05 + k as f32 * 0.4;
            self.cuboid([sx, sy, z], [sx + 0.3, sy + 1.2, z + 0.025]);
            let mut y = sy + 0.03;
            while y < sy + 1.05 {
                let w = self.uniform(0.02, 0.06);
                let (deep, high) = (self.uniform(0.15, 0.28), self.uniform(0.15, 0.33));
                self.cuboid(
                    [sx + 0.02, y, z + 0.025],
                    [sx + deep, y + w, z + 0.025 + high],
                );
                y += w + 0.003;
            }
        }
        // A sofa and clutter.
        let (fx, fy) = (ox + ROOM.x - 1.2, oy + ROOM.y - 2.4);
        self.cuboid([fx, fy, 0.1], [fx + 0.9, fy + 1.8, 0.42]);
        self.cuboid([fx + 0.7, fy, 0.42], [fx + 0.95, fy + 1.8, 0.85]);
        for _ in 0..4 {
            let r = self.uniform(0.1, 0.25);
            let centre = Vec3::new(ox + self.uniform(0.6, 4.4), oy + self.uniform(0.6, 3.9), r);
            self.ball(centre, r);
        }
        for _ in 0..6 {
            let r = self.uniform(0.04, 0.12);
            let centre = Vec3::new(
                tx + self.uniform(0.1, 1.3),
                ty + self.uniform(0.1, 0.7),
                0.76 + r,
            );
            self.ball(centre, r);
        }
    }

    fn uniform(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.random.random::<f32>()
    }

    fn cuboid(&mut self, low: [f32; 3], high: [f32; 3]) {
        let (low, d) = (Vec3::from(low), Vec3::from(high) - Vec3::from(low));
        let (x, y, z) = (Vec3::X * d.x, Vec3::Y * d.y, Vec3::Z * d.z);
        for (corner, a, b) in [
            (low, y, x),
            (low + z, x, y),
            (low, x, z),
            (low + y, z, x),
            (low, z, y),
            (low + x, y, z),
        ] {
            self.sheet(|s, t| corner + a * s + b * t, a.length(), b.length());
        }
    }

    fn ball(&mut self, centre: Vec3, radius: f32) {
        let point = |s: f32, t: f32| {
            let ((st, ct), (sp, cp)) = (
                (std::f32::consts::PI * t).sin_cos(),
                (std::f32::consts::TAU * s).sin_cos(),
            );
            centre + radius * Vec3::new(st * cp, st * sp, ct)
        };
        self.sheet(point, 6.3 * radius, 3.2 * radius);
    }

    fn sheet(&mut self, point: impl Fn(f32, f32) -> Vec3, width: f32, height: f32) {
        let cells = |length: f32| (length / self.cell).ceil().max(1.0) as u32;
        let (nu, nv) = (cells(width), cells(height));
        let first = self.mesh.vertices.len() as u32;
        let bump = (self.cell * 0.15).min(0.006);
        for v in 0..=nv {
            for u in 0..=nu {
                let p = point(u as f32 / nu as f32, v as f32 / nv as f32);
                let noise = Vec3::from_array(std::array::from_fn(|_| self.uniform(-bump, bump)));
                self.mesh.vertices.push(p + noise);
            }
        }
        for v in 0..nv {
            for u in 0..nu {
                let p = first + v * (nu + 1) + u;
                let q = p + nu + 1;
                self.mesh
                    .triangles
                    .extend([[p, p + 1, q + 1], [p, q + 1, q]]);
            }
        }
    }
}

fn poses(count: usize) -> Vec<Pose> {
    let mut random = Pcg64Mcg::seed_from_u64(42);
    let mut uniform = |low: f32, high: f32| low + (high - low) * random.random::<f32>();
    (0..count)
        .map(|_| {
            let room = Vec3::new(
                uniform(0.0, 4.0).floor() * ROOM.x,
                uniform(0.0, 3.0).floor() * ROOM.y,
                0.0,
            );
            let eye = room + Vec3::new(uniform(0.6, 4.0), uniform(0.5, 4.0), uniform(0.5, 2.0));
            Pose::from_yaw_pitch(eye, uniform(0.0, std::f32::consts::TAU), uniform(-0.5, 0.2))
        })
        .collect()
}

fn images(c: &mut Criterion) {
    let poses = poses(16);
    for cell in [1.0, 0.24, 0.0915] {
        let mesh = Apartment::build(cell);
        let mut group = c.benchmark_group(format!("depth/{}k", mesh.triangles.len() / 1000));
        group.sample_size(10);
        for (width, height) in [(64, 48), (160, 120), (320, 240), (640, 480)] {
            let (hfov, vfov) = (std::f64::consts::FRAC_PI_2, 2.0 * 0.75f64.atan());
            let Ok(camera) = Camera::from_fov(width, height, hfov, vfov, 0.0, 100.0) else {
                continue;
            };
            let mut depth = vec![0.0; camera.pixels()];
            group.throughput(Throughput::Elements((camera.pixels() * poses.len()) as u64));
            for isa in Isa::available() {
                let renderer = DepthRenderer::with_isa(&mesh, isa);
                for method in [Method::Rays, Method::Packets, Method::Raster] {
                    let name = BenchmarkId::new(
                        format!("{isa:?}/{method:?}"),
                        format!("{width}x{height}"),
                    );
                    group.bench_function(name, |b| {
                        b.iter(|| {
                            for pose in &poses {
                                renderer.render_by(method, &camera, pose, &mut depth);
                                black_box(&depth);
                            }
                        })
                    });
                }
            }
        }
        group.finish();
        let mut group = c.benchmark_group(format!("cast/{}k", mesh.triangles.len() / 1000));
        group.throughput(Throughput::Elements(16 * 256));
        for isa in Isa::available() {
            let renderer = DepthRenderer::with_isa(&mesh, isa);
            group.bench_function(format!("{isa:?}"), |b| {
                b.iter(|| {
                    for pose in &poses {
                        for k in 0..256 {
                            let angle = k as f32 * 0.0245;
                            let direction =
                                Vec3::new(angle.cos(), angle.sin(), 0.3 * (angle * 5.0).sin())
                                    .normalize();
                            black_box(renderer.cast(pose.translation, direction, 20.0));
                        }
                    }
                })
            });
        }
        group.finish();
        c.bench_function(&format!("build/{}k", mesh.triangles.len() / 1000), |b| {
            b.iter(|| DepthRenderer::new(&mesh))
        });
    }
}

criterion_group!(benches, images);
criterion_main!(benches);
