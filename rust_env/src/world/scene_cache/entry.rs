//! What an entry holds, as bytes. Neither reader trusts what it reads: a flipped byte behind a valid checksum gives a fault or
//! another scene, never a panic.
use std::collections::BTreeMap;
use std::path::PathBuf;

use crate::geometry::{Vec2, Vec3};
use crate::world::bodies::Walker;
use crate::world::bytes::{Fault, Reader, Writer};
use crate::world::ground_truth::GroundTruth;
use crate::world::render::DepthRenderer;
use crate::world::scene::{LoadReport, Scene};
use crate::world::scenes::disk::{Answers, Question, MAX_QUESTIONS};

/// A scene as it was read, what is computed from it, and what the disk had to say.
pub struct SceneEntry {
    pub answers: Answers,
    pub scene: Scene,
    pub renderer: DepthRenderer,
    pub starts: Vec<(Vec3, f32)>,
}

/// `None` if a path is no text.
pub(in crate::world) fn scene_bytes(
    answers: &Answers,
    scene: &Scene,
    renderer: &DepthRenderer,
    starts: &[(Vec3, f32)],
) -> Option<Vec<u8>> {
    let mut out = Writer::default();
    out.u64(answers.0.len() as u64);
    for ((path, question), answer) in &answers.0 {
        out.text(path.to_str()?);
        out.u8(*question as u8);
        out.u128(*answer);
    }
    // Named one by one: a new field must not be forgotten here.
    let Scene {
        name,
        visual,
        objects,
        collision,
        ground_plane,
        floor,
        bounds,
        starts: known,
        actors,
        report,
    } = scene;
    out.text(name);
    out.mesh(visual);
    out.u64(objects.len() as u64);
    objects.iter().for_each(|number| out.u32(*number));
    out.mesh(collision);
    out.u8(ground_plane.is_some().into());
    out.f32(ground_plane.unwrap_or(0.0));
    out.f32(*floor);
    out.aabb(bounds);
    write_starts(&mut out, known);
    out.u64(actors.len() as u64);
    for actor in actors {
        write_actor(&mut out, actor);
    }
    let LoadReport {
        visual_triangles_read,
        collision_triangles_read,
        instances,
        warnings,
        missing,
        visual_bounds,
        collision_bounds,
        load_milliseconds: _,
        cache: _,
    } = report;
    for count in [visual_triangles_read, collision_triangles_read, instances] {
        out.u64(*count as u64);
    }
    out.texts(warnings);
    out.texts(missing);
    out.aabb(visual_bounds);
    out.aabb(collision_bounds);
    write_starts(&mut out, starts);
    renderer.write(&mut out);
    Some(out.0)
}

/// A scene from the payload of an entry.
///
/// # Errors
/// What is wrong with the bytes.
pub fn read_scene(bytes: &[u8]) -> Result<SceneEntry, Fault> {
    let mut from = Reader(bytes);
    let answers = read_answers(&mut from)?;
    let name = from.text()?;
    let visual = from.mesh()?;
    let objects = read_objects(&mut from, visual.triangles.len())?;
    let scene = Scene {
        name,
        visual,
        objects,
        collision: from.mesh()?,
        ground_plane: {
            let there = from.u8()? != 0;
            let height = from.coordinate()?;
            there.then_some(height)
        },
        floor: from.coordinate()?,
        bounds: from.aabb()?,
        starts: read_starts(&mut from)?,
        actors: read_actors(&mut from)?,
        report: {
            let mut count = || -> Result<usize, Fault> {
                usize::try_from(from.u64()?).map_err(|_| "a number beyond memory")
            };
            LoadReport {
                visual_triangles_read: count()?,
                collision_triangles_read: count()?,
                instances: count()?,
                warnings: from.texts()?,
                missing: from.texts()?,
                visual_bounds: from.aabb()?,
                collision_bounds: from.aabb()?,
                ..LoadReport::default()
            }
        },
    };
    let starts = read_starts(&mut from)?;
    let renderer = DepthRenderer::read(&mut from, &scene.visual)?;
    if !from.0.is_empty() {
        return Err("more bytes than a scene has");
    }
    Ok(SceneEntry {
        answers,
        scene,
        renderer,
        starts,
    })
}

pub(in crate::world) fn truth_bytes(truth: &GroundTruth) -> Vec<u8> {
    let mut out = Writer::default();
    truth.write(&mut out);
    out.0
}

/// The ground truth of a task from the payload of an entry.
///
/// # Errors
/// What is wrong with the bytes.
pub fn read_truth(bytes: &[u8]) -> Result<GroundTruth, Fault> {
    let mut from = Reader(bytes);
    let truth = GroundTruth::read(&mut from)?;
    if from.0.is_empty() {
        Ok(truth)
    } else {
        Err("more bytes than a ground truth has")
    }
}

fn read_answers(from: &mut Reader) -> Result<Answers, Fault> {
    let count = from.count(25)?;
    if count > MAX_QUESTIONS {
        return Err("too many questions");
    }
    let mut answers = BTreeMap::new();
    for _ in 0..count {
        let path = PathBuf::from(from.text()?);
        let question = match from.u8()? {
            q if q == Question::Kind as u8 => Question::Kind,
            q if q == Question::Bytes as u8 => Question::Bytes,
            q if q == Question::Names as u8 => Question::Names,
            q if q == Question::Target as u8 => Question::Target,
            _ => return Err("an unknown question"),
        };
        answers.insert((path, question), from.u128()?);
    }
    Ok(Answers(answers))
}

/// One number for each of the visual triangles.
fn read_objects(from: &mut Reader, triangles: usize) -> Result<Vec<u32>, Fault> {
    let count = from.count(4)?;
    if count != triangles {
        return Err("object numbers for other triangles");
    }
    (0..count).map(|_| from.u32()).collect()
}

fn write_starts(out: &mut Writer, starts: &[(Vec3, f32)]) {
    out.u64(starts.len() as u64);
    for (position, yaw) in starts {
        out.vec3(*position);
        out.f32(*yaw);
    }
}

fn read_starts(from: &mut Reader) -> Result<Vec<(Vec3, f32)>, Fault> {
    let count = from.count(16)?;
    (0..count)
        .map(|_| Ok((from.point()?, from.coordinate()?)))
        .collect()
}

fn write_actor(out: &mut Writer, actor: &Walker) {
    let Walker {
        path,
        round,
        speed,
        radius,
        height,
        floor,
        walked: _,
    } = actor;
    out.u64(path.len() as u64);
    for p in path {
        out.f32(p.x);
        out.f32(p.y);
    }
    out.u8((*round).into());
    for value in [speed, radius, height, floor] {
        out.f32(*value);
    }
}

fn read_actors(from: &mut Reader) -> Result<Vec<Walker>, Fault> {
    let count = from.count(25)?;
    let mut actors = Vec::new();
    for _ in 0..count {
        let points = from.count(8)?;
        let path: Result<Vec<Vec2>, Fault> = (0..points)
            .map(|_| Ok(Vec2::new(from.coordinate()?, from.coordinate()?)))
            .collect();
        let actor = Walker {
            path: path?,
            round: from.u8()? != 0,
            speed: from.f32()?,
            radius: from.f32()?,
            height: from.f32()?,
            floor: from.f32()?,
            walked: 0.0,
        };
        actor.check().map_err(|_| "an impossible actor")?;
        actors.push(actor);
    }
    Ok(actors)
}
