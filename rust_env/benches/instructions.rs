//! The three hot loops once each, for counting their instructions: `make instructions` runs this under callgrind and
//! compares with `instructions.json`. Counts do not depend on how busy the machine is, times do.
//!
//! Callgrind writes a sum at every call of `instruction_mark`: what was counted since the call before. Valgrind emulates a
//! processor with AVX2, never with AVX-512: the AVX2 kernels are what is counted.
use nbv_core::belief::gain::Gain;
use nbv_core::belief::octree::SensorModel;
use nbv_core::belief::viewpoints::ViewSpace;
use nbv_core::belief::{Belief, Prior};
use nbv_core::camera::Camera;
use nbv_core::error::Result;
use nbv_core::geometry::Pose;
use nbv_core::robot::Robot;
use nbv_core::setup::{MapSpec, SceneChoice, Setup, Truth};
use nbv_core::world::bodies::BodiesSpec;
use nbv_core::world::render::{DepthRenderer, Isa, Method};
use nbv_core::world::{SceneAssets, SceneSource};
use std::hint::black_box;
use std::sync::Arc;

/// The end of one part and the beginning of the next, for callgrind to find by its name.
#[no_mangle]
#[inline(never)]
extern "C" fn instruction_mark(part: u32) {
    black_box(part);
}

fn render(renderer: &DepthRenderer, camera: &Camera, poses: &[Pose]) {
    let mut image = vec![0.0; camera.pixels()];
    for pose in poses {
        for method in [Method::Rays, Method::Packets, Method::Raster] {
            renderer.render_by(method, camera, pose, &mut image);
            black_box(&image);
        }
    }
}

fn integrate(belief: &mut Belief, poses: &[Pose], images: &[Vec<f32>]) -> Result<()> {
    for (pose, image) in poses.iter().zip(images) {
        belief.moved(pose, *pose);
        belief.observe(image)?;
    }
    Ok(())
}

fn gains(belief: &Belief, views: &[Pose]) -> Result<()> {
    for gain in [Gain::UnknownCount, Gain::Entropy, Gain::Uncertainty] {
        black_box(belief.view_gain(views, gain, 1, None)?);
    }
    Ok(())
}

fn main() -> Result<()> {
    let camera = |width, height| Camera::from_fov(width, height, 1.05, 0.817, 0.05, 4.0);
    let source = SceneSource::Generated {
        kind: "room".to_owned(),
        seed: 6,
    };
    let assets = SceneAssets::open(&source)?;
    let views = ViewSpace::dome(14, 48, 0.6, -0.6, 1.0)?;
    let setup = Arc::new(Setup {
        scene: SceneChoice::parse("room:6")?,
        camera: camera(64, 48)?,
        robot: Robot::flying(0.1, 1.0, 1.0)?,
        map: MapSpec::new(0.1, 4.0, SensorModel::default())?,
        views: views.clone(),
        local_map: None,
        noise: None,
        lidar: None,
        bodies: BodiesSpec::default(),
        truth: Truth::default(),
    });
    let anchor = assets.starts.first().map_or_else(
        || assets.scene.bounds.center(),
        |(position, _heading)| *position,
    );
    let poses: Vec<Pose> = views
        .views(&Pose::IDENTITY, anchor)
        .into_iter()
        .step_by(41)
        .collect();

    let mut images = vec![vec![0.0; setup.camera.pixels()]; poses.len()];
    for (pose, image) in poses.iter().zip(&mut images) {
        assets.renderer.render(&setup.camera, pose, image);
    }
    let prior = Prior {
        bounds: assets.scene.bounds,
        start: poses[0],
        anchor,
    };
    let mut belief = Belief::new(&setup, prior)?;

    // The parts, in the order of the names in `tests/test_instructions.py`.
    instruction_mark(0);
    render(&assets.renderer, &camera(128, 96)?, &poses);
    instruction_mark(1);
    integrate(&mut belief, &poses, &images)?;
    instruction_mark(2);
    gains(&belief, &poses)?;
    instruction_mark(3);
    println!("{:?}", Isa::best());
    Ok(())
}
