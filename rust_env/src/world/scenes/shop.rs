//! "shop": a sales floor with shelves, racks and counters, or a cafe; 100-220 m2 with a back room.
use super::draft::Draft;
use super::draw::{Draw, Random};
use super::fixtures as fix;
use super::floorplan::{by_purpose, Cell, Plan};
use super::footprint::{area, edges};
use super::furnish::{floor_clutter, hang_things, reserve_start, Purpose};
use super::furniture as make;
use super::groups::{chairs_around, kitchen_run, round_seats};
use super::layout::{Layout, Placed, Use};
use super::objects as small;
use super::seats;
use glam::Vec2;
use std::f32::consts::PI;

pub(super) fn shop(random: &mut Random) -> Draft {
    let is_cafe = random.chance(0.4);
    let mut plan = plan(is_cafe, random);
    plan.connect(0.3, random);
    plan.enter(
        |c| matches!(c.purpose, Purpose::Sales | Purpose::Cafe),
        random,
    );
    plan.windows(2.6, random);
    plan.build(random, |layout, purpose, free, random| match purpose {
        Purpose::Sales => sales_floor(layout, free, random),
        Purpose::Cafe => cafe(layout, free, random),
        _ => by_purpose(layout, purpose, free, random),
    })
}

fn plan(is_cafe: bool, r: &mut Random) -> Plan {
    let size = r.between(100.0, 220.0);
    let aspect = r.between(1.0, 1.8);
    let max = Vec2::new((size * aspect).sqrt(), (size / aspect).sqrt());
    let purpose = if is_cafe {
        Purpose::Cafe
    } else {
        Purpose::Sales
    };
    let whole = Cell::new(Vec2::ZERO, max, purpose);
    let mut cells = vec![whole];
    if r.chance(0.75) {
        let [front, mut back] = whole.split(true, r.between(0.7, 0.82));
        back.purpose = if is_cafe {
            Purpose::Kitchen
        } else {
            Purpose::Storage
        };
        cells = vec![front];
        if back.size().y > 6.0 {
            let [back, mut small] = back.split(false, r.between(0.5, 0.7));
            small.purpose = r.one_of(&[Purpose::Bathroom, Purpose::Study, Purpose::Storage]);
            cells.extend([back, small]);
        } else {
            cells.push(back);
        }
    }
    let mut plan = Plan::new(cells, r);
    plan.height = r.between(2.8, 4.0);
    plan
}

/// Wall shelves all round, rows of double-sided shelves in between, tables with goods, a till at the door.
fn sales_floor(layout: &mut Layout, free: f32, r: &mut Random) {
    layout.fullness = r.between(0.5, 0.95);
    layout.segments = 8;
    let size = area(&layout.outline);
    reserve_start(layout, free, r);
    till(layout, r);
    let (row_half, height) = (r.between(0.3, 0.45), r.between(1.3, 2.0));
    let aisle = r.between(1.5, 2.3);
    rows(layout, row_half, height, aisle, r);
    // Shelves along the walls.
    let unit = r.between(0.9, 1.2);
    for (a, b) in walls(layout) {
        if r.chance(0.35) {
            continue;
        }
        let along = (b - a).normalize_or(Vec2::X);
        let mut s = 0.5;
        while s + unit < a.distance(b) {
            let deep = 0.4;
            let tall = height + 0.3;
            if r.chance(0.85) && layout.covered < 0.26 * size {
                let shelf = make::shelf(r, unit, deep, tall, Use::Goods);
                let at = a + along * (s + unit / 2.0) + along.perp() * (deep / 2.0 + 0.02);
                layout.put(&shelf, at, along.to_angle(), 0.0, r);
            }
            s += unit + 0.005;
        }
    }
    for _ in 0..r.count(1, 4) {
        let (w, d) = (r.between(0.8, 1.5), r.between(0.6, 1.0));
        let table = make::table(r, w, d, 0.8, Use::Cupboard);
        layout.anywhere(&table, 8, r);
    }
    for _ in 0..r.count(1, 4) {
        let rack = clothes_rack(r);
        layout.anywhere(&rack, 8, r);
    }
    finish(layout, Purpose::Sales, size, r);
}

/// Rows of shelves back to back, square to the longer wall, with an aisle between rows.
fn rows(layout: &mut Layout, half: f32, height: f32, aisle: f32, r: &mut Random) {
    let size = area(&layout.outline);
    let (min, max) = extent(layout);
    let margin = r.between(1.6, 2.2);
    let mut x = min.x + margin + half;
    while x + half + 1.0 < max.x {
        let mut y = min.y + margin;
        let unit = r.between(0.9, 1.25);
        while y + unit + margin < max.y {
            if r.chance(0.9) && layout.covered < 0.2 * size {
                for side in [-1.0f32, 1.0] {
                    let shelf = make::shelf(r, unit, half - 0.005, height, Use::Goods);
                    // Backs together: fronts look into both aisles.
                    let at = Vec2::new(x + side * half / 2.0, y + unit / 2.0);
                    layout.put(&shelf, at, -side * PI / 2.0, 0.0, r);
                }
            }
            y += unit + 0.005;
        }
        x += 2.0 * half + aisle;
    }
}

/// A counter with a till and a chair behind it, near the middle of a wall.
fn till(layout: &mut Layout, r: &mut Random) -> Option<Placed> {
    let size = [r.between(1.4, 2.6), 0.65, r.between(0.9, 1.05)];
    let mut counter = make::cupboard(r, size, 3, 1);
    counter.surfaces.clear();
    counter.top(0.03, size[2], Use::Desk);
    for _ in 0..20 {
        let (a, b) = r.one_of(&walls(layout));
        let along = (b - a).normalize_or(Vec2::X);
        let at = a + (b - a) * r.between(0.2, 0.8) + along.perp() * r.between(1.3, 1.8);
        if let Some(placed) = layout.put(&counter, at, along.to_angle(), 0.0, r) {
            let stool = seats::stool(r, 0.7);
            let behind = placed.point(Vec2::new(r.between(-0.4, 0.4), -0.8));
            layout.put(&stool, behind, 0.0, 0.0, r);
            return Some(placed);
        }
    }
    None
}

/// A rail on two stands with clothes on it.
fn clothes_rack(r: &mut Random) -> super::layout::Piece {
    use super::solid;
    use crate::geometry::Vec3;
    let (w, h) = (r.between(1.0, 1.6), r.between(1.3, 1.6));
    let mut piece = super::layout::Piece::new(w, 0.5, h);
    let x = w / 2.0 - 0.02;
    for s in [-1.0f32, 1.0] {
        let foot = Vec3::new(s * x, 0.0, 0.0);
        solid::tube(&mut piece.mesh, foot, foot + Vec3::Z * h, 0.015, 0.015, 6);
        let half = Vec3::new(0.015, 0.24, 0.02);
        solid::turned_cuboid(&mut piece.mesh, foot + Vec3::Z * 0.02, half, 0.0);
    }
    let (a, b) = (Vec3::new(-x, 0.0, h - 0.02), Vec3::new(x, 0.0, h - 0.02));
    solid::tube(&mut piece.mesh, a, b, 0.012, 0.012, 6);
    let mut s = -x + 0.08;
    while s < x - 0.08 {
        let length = r.between(0.6, 1.0);
        let thick = r.between(0.02, 0.05);
        let center = Vec3::new(s, 0.0, h - 0.05 - length / 2.0);
        let half = Vec3::new(thick, r.between(0.17, 0.23), length / 2.0);
        solid::soft_box(&mut piece.mesh, center, half, 0.5, 8);
        s += r.between(0.09, 0.2);
    }
    piece
}

/// A bar with stools, tables with chairs, a few sofas.
fn cafe(layout: &mut Layout, free: f32, r: &mut Random) {
    layout.fullness = r.between(0.4, 0.9);
    layout.segments = 10;
    let size = area(&layout.outline);
    reserve_start(layout, free, r);
    bar(layout, r);
    let share = r.between(0.13, 0.2);
    for _ in 0..60 {
        if layout.covered > share * size {
            break;
        }
        let at = layout.point(r);
        let yaw = layout.any_yaw(r);
        if r.chance(0.5) {
            let radius = r.between(0.33, 0.5);
            let table = make::round_table(r, radius, 0.74, Use::Dining);
            if let Some(table) = layout.put(&table, at, yaw, 0.0, r) {
                round_seats(layout, &table, r);
            }
        } else {
            let (w, d) = (r.between(0.7, 1.6), r.between(0.65, 0.85));
            let table = make::table(r, w, d, 0.75, Use::Dining);
            if let Some(table) = layout.put(&table, at, yaw, 0.0, r) {
                let seats = if w > 1.2 { 6 } else { 2 };
                chairs_around(layout, &table, seats, false, r);
            }
        }
    }
    for _ in 0..r.count(0, 3) {
        let seats = r.count(1, 3);
        let sofa = seats::sofa(r, seats);
        layout.against_wall(&sofa, 0.0, 10, r);
    }
    finish(layout, Purpose::Cafe, size, r);
}

/// A counter at some distance from a wall, stools in front, kitchen units and shelves behind.
fn bar(layout: &mut Layout, r: &mut Random) {
    let counter = make::cupboard(r, [1.2, 0.6, 1.08], 2, 1);
    let length = r.count(2, 4);
    let (a, b) = r.one_of(&walls(layout));
    let along = (b - a).normalize_or(Vec2::X);
    let from = r.between(0.3, (a.distance(b) - 1.2 * length as f32).max(0.4));
    let away = r.between(1.7, 2.2);
    for i in 0..length {
        let s = from + 1.205 * (i as f32 + 0.5);
        let at = a + along * s + along.perp() * away;
        let Some(unit) = layout.put(&counter, at, along.to_angle(), 0.0, r) else {
            continue;
        };
        for x in [-0.3, 0.3] {
            let stool = seats::stool(r, 0.75);
            let out = unit.point(Vec2::new(x, unit.half.y + r.between(0.22, 0.33)));
            if r.chance(0.7) {
                layout.put(&stool, out, r.heading(), 0.0, r);
            }
        }
        let back = fix::counter(r, [1.19, 0.6, 0.92], fix::Unit::Plain);
        let at = a + along * s + along.perp() * 0.32;
        layout.put(&back, at, along.to_angle(), 0.0, r);
    }
    if r.chance(0.4) {
        kitchen_run(layout, r);
    }
}

/// Plants, bins, hung things, clutter: what all shops have.
fn finish(layout: &mut Layout, purpose: Purpose, size: f32, r: &mut Random) {
    for _ in 0..r.count(1, 5) {
        let piece = match r.count(0, 3) {
            0 => fix::bin(r),
            1 => small::carton_stack(r),
            _ => fix::plant(r),
        };
        layout.against_wall(&piece, 0.0, 8, r);
    }
    hang_things(layout, purpose, size.min(60.0), r);
    floor_clutter(layout, purpose, size.min(60.0), r);
}

fn walls(layout: &Layout) -> Vec<(Vec2, Vec2)> {
    edges(&layout.outline).collect()
}

/// The outline's bounding rectangle.
pub(super) fn extent(layout: &Layout) -> (Vec2, Vec2) {
    let fold = |f: fn(Vec2, Vec2) -> Vec2| layout.outline.iter().copied().reduce(f);
    (
        fold(Vec2::min).unwrap_or_default(),
        fold(Vec2::max).unwrap_or_default(),
    )
}
