//! "warehouse": a high hall with rows of pallet racks, aisles of 1.7-2.6 m, pallets on the floor, an office in a corner.
use super::draft::Draft;
use super::draw::{Draw, Random};
use super::floorplan::{by_purpose, Cell, Plan};
use super::footprint::area;
use super::furnish::{floor_clutter, reserve_start, Purpose};
use super::layout::{Layout, Piece, Use};
use super::objects as small;
use super::shop::extent;
use super::solid;
use crate::geometry::Vec3;
use glam::Vec2;
use std::f32::consts::FRAC_PI_2;

pub(super) fn warehouse(random: &mut Random) -> Draft {
    let size = random.between(180.0, 480.0);
    let aspect = random.between(1.1, 1.9);
    let max = Vec2::new((size * aspect).sqrt(), (size / aspect).sqrt());
    let hall = Cell::new(Vec2::ZERO, max, Purpose::Warehouse);
    let mut cells = vec![hall];
    if random.chance(0.5) {
        let [hall, side] = hall.split(true, 1.0 - random.between(3.2, 4.2) / max.x);
        let [mut office, mut store] = side.split(false, random.between(0.35, 0.65));
        office.purpose = Purpose::Office;
        store.purpose = Purpose::Storage;
        cells = vec![hall, office, store];
    }
    let mut plan = Plan::new(cells, random);
    plan.height = random.between(4.2, 6.5);
    plan.connect(0.2, random);
    for _ in 0..random.count(1, 3) {
        plan.gate(random);
    }
    plan.build(random, |layout, purpose, free, random| {
        if purpose == Purpose::Warehouse {
            hall_with_racks(layout, free, random);
        } else {
            by_purpose(layout, purpose, free, random);
        }
    })
}

fn hall_with_racks(layout: &mut Layout, free: f32, r: &mut Random) {
    layout.fullness = r.between(0.4, 0.95);
    layout.segments = 8;
    let size = area(&layout.outline);
    reserve_start(layout, free, r);
    pillars(layout, r);
    let (min, max) = extent(layout);
    let (bay, deep) = (r.between(1.9, 2.8), r.between(0.85, 1.1));
    let levels = r.count(2, 3);
    let aisle = r.between(1.7, 2.6);
    let twin = r.chance(0.5);
    let margin = r.between(1.3, 2.2);
    let share = r.between(0.18, 0.28);
    let mut y = min.y + margin + deep / 2.0;
    let mut back_to_back = false;
    while y + deep / 2.0 + 0.8 < max.y {
        let gap = r.between(0.35, 0.65) * (max.x - min.x);
        let mut x = min.x + margin;
        while x + bay + 1.2 < max.x {
            // A cross aisle breaks the row once.
            let is_cross = (x - min.x - gap).abs() < bay / 2.0;
            if !is_cross && r.chance(0.93) && layout.covered < share * size {
                let rack = rack(r, bay, deep, levels);
                let yaw = FRAC_PI_2 * if back_to_back { -2.0 } else { 0.0 };
                layout.put(&rack, Vec2::new(x + bay / 2.0, y), yaw, 0.0, r);
            }
            x += bay + 0.01;
        }
        back_to_back = twin && !back_to_back;
        y += deep + if back_to_back { 0.1 } else { aisle };
    }
    for _ in 0..(size / 18.0) as usize {
        let pallet = pallet(r);
        if r.chance(0.6) {
            layout.against_wall(&pallet, 0.0, 8, r);
        } else {
            layout.anywhere(&pallet, 4, r);
        }
    }
    for _ in 0..r.count(2, 6) {
        let stack = small::carton_stack(r);
        layout.anywhere(&stack, 6, r);
    }
    floor_clutter(layout, Purpose::Warehouse, size.min(60.0), r);
}

fn pillars(layout: &mut Layout, r: &mut Random) {
    if r.chance(0.4) {
        return;
    }
    let (min, max) = extent(layout);
    let size = r.between(0.25, 0.45);
    let pillar = small::box_of(size, size, layout.height - 0.01);
    let count = ((max - min) / r.between(5.0, 7.0)).floor();
    for i in 1..=count.x as usize {
        for j in 1..=count.y as usize {
            let share = Vec2::new(i as f32, j as f32) / (count + 1.0);
            layout.put(&pillar, min + (max - min) * share, 0.0, 0.0, r);
        }
    }
}

/// One bay of a pallet rack: four posts, beams and loads on every level, the lowest on the floor.
fn rack(r: &mut Random, width: f32, depth: f32, levels: usize) -> Piece {
    let pitch = r.between(1.3, 1.6);
    let height = pitch * levels as f32 + 0.3;
    let mut piece = Piece::hollow(width, depth, height);
    let v = Vec3::new;
    let (x, y, post) = (width / 2.0, depth / 2.0, 0.08);
    for s in [-1.0f32, 1.0] {
        for t in [-1.0f32, 1.0] {
            let c = v(s * (x - post / 2.0), t * (y - post / 2.0), 0.0);
            let half = v(post / 2.0, post / 2.0, 0.0);
            piece.part(c - half, c + half + Vec3::Z * height);
        }
        // Braces between the posts of a frame.
        let side = s * (x - post / 2.0);
        for i in 0..levels {
            let (z0, z1) = (pitch * i as f32 + 0.2, pitch * (i + 1) as f32);
            let (a, b) = (v(side, -y + post, z0), v(side, y - post, z1));
            solid::tube(&mut piece.mesh, a, b, 0.015, 0.015, 4);
        }
        // Nothing goes through between the braces.
        let half = v(0.015, y - post, 0.0);
        piece.block(
            v(side, 0.0, 0.15) - half,
            v(side, 0.0, pitch * levels as f32 + 0.05) + half,
        );
    }
    for i in 0..=levels {
        let z = pitch * i as f32;
        let mut shelf = 0.0;
        if i > 0 {
            for t in [-1.0f32, 1.0] {
                let c = t * (y - 0.03);
                piece.part(v(-x + post, c - 0.025, z - 0.12), v(x - post, c + 0.025, z));
            }
            let deck = y - 0.055;
            piece.part(v(-x + post, -deck, z - 0.03), v(x - post, deck, z));
            shelf = z;
        }
        if i == levels && r.chance(0.5) {
            continue;
        }
        let headroom = if i == levels { 0.9 } else { pitch - 0.2 };
        let loads = if width > 2.3 { 2 } else { 1 };
        let each = (width - 2.0 * post - 0.1) / loads as f32;
        for k in 0..loads {
            let center = -x + post + 0.05 + each * (k as f32 + 0.5);
            let half = Vec2::new((each / 2.0 - 0.06).min(0.62), (y - 0.09).min(0.42));
            let at = Vec2::new(center, 0.0);
            let deck = deck(&mut piece, at, half, shelf);
            piece.surface(at - half, at + half, deck, headroom - 0.15, Use::Pallet);
        }
    }
    piece
}

/// A wooden pallet at `z`: three skids and boards. Returns the height of its top.
fn deck(piece: &mut Piece, at: Vec2, half: Vec2, z: f32) -> f32 {
    let (min, max) = (at - half, at + half);
    for t in [0.0, 0.5, 1.0] {
        let y = min.y + (max.y - min.y - 0.09) * t;
        piece.cuboid(Vec3::new(min.x, y, z), Vec3::new(max.x, y + 0.09, z + 0.11));
    }
    for i in 0..4 {
        let x = min.x + (max.x - min.x - 0.14) * i as f32 / 3.0;
        piece.cuboid(
            Vec3::new(x, min.y, z + 0.11),
            Vec3::new(x + 0.14, max.y, z + 0.132),
        );
    }
    piece.block(min.extend(z), max.extend(z + 0.132));
    z + 0.132
}

/// A pallet on the floor with a load, or a pile of empty ones.
fn pallet(r: &mut Random) -> Piece {
    let half = Vec2::new(0.6, 0.4);
    let pile = if r.chance(0.25) { r.count(3, 9) } else { 1 };
    let mut piece = Piece::hollow(1.2, 0.8, 0.132 * pile as f32);
    let mut top = 0.0;
    for _ in 0..pile {
        top = deck(&mut piece, Vec2::ZERO, half, top);
    }
    if pile == 1 {
        piece.surface(-half, half, top, 1.5, Use::Pallet);
    }
    piece
}
