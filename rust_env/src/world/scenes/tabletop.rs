//! "tabletop": a table with three to eight varied objects on a square of floor, nothing else.
use super::crockery;
use super::draft::{Draft, CAMERA_HEIGHT, SLAB};
use super::draw::{Draw, Random};
use super::furniture as make;
use super::layout::{Layout, Piece, Spot, Use};
use super::objects as small;
use super::solid;
use crate::geometry::{Aabb, Vec3};
use glam::Vec2;
use std::f32::consts::TAU;

/// Points per turn: objects are seen from close by.
const SEGMENTS: u32 = 36;
const FLOOR_HALF: f32 = 2.0;

pub(super) fn tabletop(random: &mut Random) -> Draft {
    let floor = random.between(0.01, 0.05);
    let mut draft = Draft {
        floor,
        fixed: true,
        ..Draft::default()
    };
    let square = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
    let outline: Vec<Vec2> = square
        .iter()
        .map(|(x, y)| Vec2::new(*x, *y) * FLOOR_HALF)
        .collect();
    solid::prism(&mut draft.shell, &outline, floor - SLAB, floor);

    let height = random.between(0.7, 0.78);
    let mut table = if random.chance(0.3) {
        let radius = random.between(0.4, 0.6);
        make::round_table(random, radius, height, Use::Dining)
    } else {
        let (w, d) = (random.between(0.8, 1.3), random.between(0.6, 0.9));
        make::table(random, w, d, height, Use::Dining)
    };
    let surface = table.surfaces[0];
    table.surfaces.clear();
    let mut layout = Layout::new(outline, floor, 3.0);
    layout.segments = SEGMENTS;
    let yaw = if random.chance(1.0 / 3.0) {
        random.heading()
    } else {
        0.0
    };
    layout.put(&table, Vec2::ZERO, yaw, 0.0, random);
    let mut spot = Spot {
        surface,
        yaw,
        since: layout.solid.len(),
        near: &[],
    };
    let footprint = &mut spot.surface.footprint;
    *footprint = footprint.moved(Vec2::from_angle(yaw), Vec2::ZERO);

    // Objects gather in the middle in one scene of two: they hide each other from more sides.
    let wanted = random.count(3, 8);
    if random.chance(0.5) {
        spot.surface.footprint.half *= random.between(0.55, 0.9);
    }
    let before = layout.instances;
    for i in 0..120 {
        if layout.instances - before == wanted {
            break;
        }
        if i == 60 {
            spot.surface.footprint.half = table.half * 0.7;
        }
        // At least three are round: boxes alone would be too easy a shape.
        let piece = object(layout.instances - before < 3, random);
        let slack = spot.surface.footprint.half - piece.half.max_element();
        if slack.min_element() < 0.0 {
            continue;
        }
        let local = Vec2::new(
            random.between(-slack.x, slack.x),
            random.between(-slack.y, slack.y),
        );
        let heading = random.heading();
        layout.put_on(&piece, &spot, spot.point(local), heading, 0.0);
    }

    let reach = table.half.length() + random.between(0.75, 0.95);
    let first = random.heading();
    draft.starts = (0..3)
        .map(|i| {
            let a = first + TAU * i as f32 / 3.0 + random.between(-0.3, 0.3);
            (Vec2::from_angle(a) * reach, a + std::f32::consts::PI)
        })
        .collect();
    debug_assert!(CAMERA_HEIGHT > height);
    draft.bounds = Some(top_bounds(&table, yaw, floor + height));
    draft.rooms.push(layout);
    draft
}

/// From 0.2 m below the table's surface to 0.2 m above the 0.6 m where objects may be, 0.2 m around the top.
fn top_bounds(table: &Piece, yaw: f32, surface: f32) -> Aabb {
    let (s, c) = yaw.sin_cos();
    let (s, c) = (s.abs(), c.abs());
    let h = table.half;
    let half = Vec2::new(h.x * c + h.y * s, h.x * s + h.y * c);
    let low: Vec3 = (-half).extend(surface);
    Aabb::new(low, half.extend(surface + 0.6)).grown(0.2)
}

fn object(is_round: bool, r: &mut Random) -> Piece {
    let n = SEGMENTS;
    if is_round {
        return match r.count(0, 6) {
            0 | 1 => crockery::mug(r, n),
            2 => crockery::bowl(r, n),
            3 => crockery::bottle(r, n),
            4 => crockery::vase(r, n),
            5 => crockery::fruit_bowl(r, n),
            _ => crockery::kettle(r, n),
        };
    }
    match r.weighted(&[
        2.0, 2.5, 2.0, 2.0, 1.5, 1.0, 1.5, 1.5, 1.0, 1.0, 0.7, 0.7, 0.7, 0.5, 0.5, 1.0,
    ]) {
        0 => small::carton(r, 0.06, 0.25),
        1 => crockery::mug(r, n),
        2 => crockery::bowl(r, n),
        3 => crockery::bottle(r, n),
        4 => small::sphere(r, n),
        5 => crockery::fruit_bowl(r, n),
        6 => small::book_stack(r),
        7 => crockery::vase(r, n),
        8 => crockery::tin(r, n),
        9 => crockery::pot(r, n),
        10 => crockery::kettle(r, n),
        11 => small::small_plant(r, n),
        12 => small::table_lamp(r, n),
        13 => small::toaster(r),
        14 => small::open_box(r),
        _ => crockery::plate(r, n),
    }
}
