//! Groups of furniture that belong together: sofa and television, table and chairs, bed and nightstands,
//! desk and chair, kitchen units in a row (60 % of ProcTHOR's furniture comes in groups, Deitke et al. 2022).
use super::bathroom;
use super::draw::{Draw, Random};
use super::fixtures::{self as fix, Unit};
use super::footprint::{border_distance, contains, edges, Block};
use super::furnish::{put_along_walls, Wall};
use super::furniture as make;
use super::layout::{Layout, Placed, Use};
use super::seats;
use super::solid;
use crate::geometry::Mesh;
use glam::Vec2;
use std::f32::consts::{FRAC_PI_2, PI};

pub(super) fn living(layout: &mut Layout, size: f32, r: &mut Random) {
    let seats = if size > 16.0 {
        r.count(2, 4)
    } else {
        r.count(2, 3)
    };
    let sofa = seats::sofa(r, seats);
    let tv = make::tv_stand(r);
    let tv = layout.against_wall(&tv, 0.0, 20, r);
    let facing = tv.and_then(|tv| {
        (0..8).find_map(|_| {
            let away = tv.half.y + r.between(1.9, 3.2) + sofa.half.y;
            let at = tv.point(Vec2::new(r.between(-0.4, 0.4), away));
            layout.put(&sofa, at, tv.yaw + PI + r.between(-0.05, 0.05), 0.0, r)
        })
    });
    let sofa = facing.or_else(|| layout.against_wall(&sofa, 0.0, 30, r));
    if let Some(sofa) = sofa {
        let table = make::coffee_table(r);
        let away = sofa.half.y + r.between(0.27, 0.42) + table.half.y;
        let spot = sofa.point(Vec2::new(r.between(-0.15, 0.15), away));
        if r.chance(0.5) {
            rug(layout, spot, sofa.yaw, r);
        }
        layout.put(&table, spot, sofa.yaw + r.between(-0.06, 0.06), 0.0, r);
        for side in [-1.0f32, 1.0] {
            if r.chance(0.5) {
                let chair = seats::sofa(r, 1);
                for _ in 0..6 {
                    let out = table.half.x + chair.half.y + r.between(0.3, 0.7);
                    let at = spot + Vec2::from_angle(sofa.yaw).rotate(Vec2::new(side * out, 0.1));
                    let yaw = sofa.yaw + side * FRAC_PI_2 + r.between(-0.5, 0.5);
                    if layout.put(&chair, at, yaw, 0.0, r).is_some() {
                        break;
                    }
                }
            }
            if r.chance(0.5) {
                let piece = match r.count(0, 2) {
                    0 => fix::floor_lamp(r),
                    1 => make::nightstand(r),
                    _ => fix::plant(r),
                };
                let x = side * (sofa.half.x + piece.half.x + 0.06);
                let at = sofa.point(Vec2::new(x, -sofa.half.y + piece.half.y));
                layout.put(&piece, at, sofa.yaw, 0.0, r);
            }
        }
    }
    put_along_walls(layout, &[Wall::Shelf, Wall::Shelf, Wall::Dresser], r);
    if size > 22.0 && r.chance(0.6) {
        dining_group(layout, 6, r);
    }
    if size > 26.0 {
        desk_group(layout, r);
    }
}

pub(super) fn bedroom(layout: &mut Layout, size: f32, r: &mut Random) {
    let wide = size > 11.0 && r.chance(0.7);
    let width = if wide {
        r.between(1.4, 1.85)
    } else {
        r.between(0.9, 1.2)
    };
    let bed = seats::bed(r, width);
    if let Some(bed) = layout.against_wall(&bed, 0.0, 60, r) {
        for side in [-1.0f32, 1.0] {
            if r.chance(0.75) {
                let stand = make::nightstand(r);
                let x = side * (bed.half.x + stand.half.x + r.between(0.03, 0.1));
                let at = bed.point(Vec2::new(x, stand.half.y - bed.half.y));
                layout.put(&stand, at, bed.yaw, 0.0, r);
            }
        }
        if r.chance(0.4) {
            rug(
                layout,
                bed.point(Vec2::new(0.0, bed.half.y * 0.6)),
                bed.yaw,
                r,
            );
        }
    }
    put_along_walls(layout, &[Wall::Wardrobe, Wall::Dresser], r);
    if r.chance(0.4) {
        desk_group(layout, r);
    }
    if r.chance(0.6) {
        put_along_walls(layout, &[Wall::Shelf, Wall::Low], r);
    }
    if size > 15.0 {
        armchair_corner(layout, r);
    }
}

pub(super) fn bathroom(layout: &mut Layout, r: &mut Random) {
    if r.chance(0.7) {
        let tub = bathroom::bathtub(r);
        layout.against_wall(&tub, 0.0, 30, r);
    }
    let basin = bathroom::washbasin(r);
    if let Some(basin) = layout.against_wall(&basin, 0.0, 30, r) {
        let mirror = fix::picture(r, basin.half.x * 1.8, 0.7);
        let at = basin.point(Vec2::new(0.0, mirror.half.y - basin.half.y - 0.01));
        layout.put(&mirror, at, basin.yaw, 1.2, r);
    }
    let toilet = bathroom::toilet(r);
    layout.against_wall(&toilet, 0.0, 40, r);
    if r.chance(0.5) {
        let washer = bathroom::washing_machine(r);
        layout.against_wall(&washer, 0.0, 20, r);
    }
    put_along_walls(layout, &[Wall::Low], r);
}

pub(super) fn meeting(layout: &mut Layout, size: f32, r: &mut Random) {
    let (w, d) = ((size / 5.0).clamp(1.6, 4.0), r.between(1.0, 1.4));
    let table = make::table(r, w, d, 0.74, Use::Desk);
    for _ in 0..20 {
        let (at, yaw) = (layout.point(r), layout.any_yaw(r));
        if border_distance(&layout.outline, at) > 1.2 {
            if let Some(table) = layout.put(&table, at, yaw, 0.0, r) {
                chairs_around(layout, &table, 12, true, r);
                break;
            }
        }
    }
    let board = fix::picture(r, 1.6, 1.0);
    layout.against_wall(&board, 0.9, 12, r);
    put_along_walls(layout, &[Wall::Cabinet, Wall::Dresser], r);
}

/// A table somewhere in the room with up to `seats` chairs around it.
pub(super) fn dining_group(layout: &mut Layout, seats: usize, r: &mut Random) -> Option<Placed> {
    let height = r.between(0.72, 0.77);
    let is_round = r.chance(0.25);
    let table = if is_round {
        let radius = r.between(0.42, 0.62);
        make::round_table(r, radius, height, Use::Dining)
    } else {
        let (w, d) = (
            r.between(0.9, 1.1 + 0.12 * seats as f32),
            r.between(0.7, 1.0),
        );
        make::table(r, w, d, height, Use::Dining)
    };
    let placed = (0..40).find_map(|_| {
        let at = layout.point(r);
        // Chairs need room between table and wall.
        if border_distance(&layout.outline, at) < table.half.min_element() + 0.55 {
            return None;
        }
        let yaw = layout.any_yaw(r);
        layout.put(&table, at, yaw, 0.0, r)
    })?;
    if is_round {
        round_seats(layout, &placed, r);
    } else {
        chairs_around(layout, &placed, seats, false, r);
    }
    Some(placed)
}

pub(super) fn round_seats(layout: &mut Layout, table: &Placed, r: &mut Random) {
    let style = r.clone();
    let count = r.count(2, 5);
    let first = r.heading();
    for i in 0..count {
        let chair = seats::chair(&mut style.clone());
        let a = first + 2.0 * PI * i as f32 / count as f32 + r.between(-0.15, 0.15);
        for pull in [-0.12, 0.05, 0.25] {
            let out = table.half.x + chair.half.y + pull + r.between(0.0, 0.1);
            let at = table.at + Vec2::from_angle(a) * out;
            // The chair's front (+y) looks at the table's axis.
            if layout.put(&chair, at, a + FRAC_PI_2, 0.0, r).is_some() {
                break;
            }
        }
    }
}

/// Chairs along all four sides, pushed in or pulled out, here and there one missing or astray.
pub(super) fn chairs_around(
    layout: &mut Layout,
    table: &Placed,
    seats: usize,
    office: bool,
    r: &mut Random,
) {
    // All chairs of a table are of one kind: the same stream makes the same chair.
    let style = r.clone();
    let mut sides = Vec::new();
    let along = ((2.0 * table.half.x - 0.1) / 0.6).max(1.0) as usize;
    for i in 0..along {
        let x = (i as f32 + 0.5) / along as f32 * 2.0 - 1.0;
        sides.push((Vec2::new(x * table.half.x, table.half.y), PI));
        sides.push((Vec2::new(x * table.half.x, -table.half.y), 0.0));
    }
    if seats > 4 {
        sides.push((Vec2::new(table.half.x, 0.0), FRAC_PI_2));
        sides.push((Vec2::new(-table.half.x, 0.0), -FRAC_PI_2));
    }
    for (edge, yaw) in sides.into_iter().take(seats) {
        if r.chance(0.12) {
            continue;
        }
        let chair = if office {
            seats::office_chair(&mut style.clone())
        } else {
            seats::chair(&mut style.clone())
        };
        let out = Vec2::from_angle(yaw - FRAC_PI_2);
        for pull in [-0.2, -0.05, 0.1, 0.3] {
            let pull = pull + r.between(0.0, 0.14);
            let at = table.point(edge + out * (chair.half.y + pull));
            let turn = if pull > 0.1 { 0.4 } else { 0.06 };
            let yaw = table.yaw + yaw + r.between(-turn, turn);
            if layout.put(&chair, at, yaw, 0.0, r).is_some() {
                break;
            }
        }
    }
}

/// A desk at the wall (or free-standing in large rooms) with its chair and a bin.
pub(super) fn desk_group(layout: &mut Layout, r: &mut Random) -> Option<Placed> {
    let mut desk = make::desk(r);
    desk.front = 0.55;
    let placed = layout.against_wall(&desk, 0.0, 24, r)?;
    // Its own chair may stand in the strip that was kept for it.
    layout.reserved.pop();
    let chair = if r.chance(0.7) {
        seats::office_chair(r)
    } else {
        seats::chair(r)
    };
    for pull in [-0.2, 0.0, 0.1] {
        let x = r.between(-0.15, 0.15);
        let y = placed.half.y + chair.half.y + pull + r.between(0.0, 0.15);
        let yaw = placed.yaw + PI + r.between(-0.6, 0.6);
        if layout
            .put(&chair, placed.point(Vec2::new(x, y)), yaw, 0.0, r)
            .is_some()
        {
            break;
        }
    }
    if r.chance(0.5) {
        let bin = fix::bin(r);
        let x = r.one_of(&[-1.0, 1.0]) * (placed.half.x + bin.half.x + 0.05);
        layout.put(&bin, placed.point(Vec2::new(x, 0.0)), 0.0, 0.0, r);
    }
    Some(placed)
}

pub(super) fn armchair_corner(layout: &mut Layout, r: &mut Random) {
    let chair = seats::sofa(r, 1);
    if let Some(chair) = layout.against_wall(&chair, 0.0, 12, r) {
        let lamp = fix::floor_lamp(r);
        let side = r.one_of(&[-1.0, 1.0]);
        let at = chair.point(Vec2::new(side * (chair.half.x + lamp.half.x + 0.05), -0.1));
        layout.put(&lamp, at, 0.0, 0.0, r);
    }
}

/// Fridge, units with sink and stove in a row along one or two walls, cabinets above.
pub(super) fn kitchen_run(layout: &mut Layout, r: &mut Random) {
    let walls: Vec<(Vec2, Vec2)> = edges(&layout.outline).collect();
    let (depth, height) = (r.between(0.58, 0.66), r.between(0.86, 0.93));
    let start = r.count(0, walls.len() - 1);
    let wanted = r.between(2.4, 4.6);
    let (mut built, mut has_fridge) = (0.0, false);
    let mut units = vec![Unit::Stove, Unit::Plain, Unit::Sink, Unit::Plain];
    for i in 0..walls.len() {
        let (a, b) = walls[(start + i) % walls.len()];
        let along = (b - a).normalize_or(Vec2::X);
        let yaw = along.to_angle();
        let mut s = 0.02;
        while s + 0.4 < a.distance(b) && built < wanted {
            let piece = if has_fridge {
                let width = r.one_of(&[0.4, 0.5, 0.6, 0.6, 0.8]);
                let unit = units.last().copied().unwrap_or(Unit::Plain);
                let width = if unit == Unit::Plain { width } else { 0.6 };
                fix::counter(r, [width, depth, height], unit)
            } else {
                fix::fridge(r)
            };
            let at = a + along * (s + piece.half.x) + along.perp() * (piece.half.y + 0.005);
            if layout.put(&piece, at, yaw, 0.0, r).is_none() {
                s += 0.15;
                continue;
            }
            if has_fridge {
                units.pop();
                let cabinet = fix::wall_cabinet(r, 2.0 * piece.half.x);
                let lift = height + r.one_of(&[0.5, 0.5, 0.55]);
                let at = a + along * (s + piece.half.x) + along.perp() * (cabinet.half.y + 0.003);
                if r.chance(0.8) {
                    layout.put(&cabinet, at, yaw, lift, r);
                }
            }
            has_fridge = true;
            built += 2.0 * piece.half.x;
            s += 2.0 * piece.half.x + 0.003;
        }
        if built > 0.6 * wanted {
            break;
        }
    }
}

pub(super) fn rug(layout: &mut Layout, at: Vec2, yaw: f32, r: &mut Random) {
    let half = Vec2::new(r.between(0.8, 1.3), r.between(0.6, 0.95));
    let block = Block::new(at, half, yaw, [0.0, 0.008]);
    // A rug may lie under anything that stands on legs, but not reach into a wall.
    if block
        .footprint
        .corners()
        .iter()
        .all(|c| contains(&layout.outline, *c))
    {
        let mut mesh = Mesh::default();
        solid::cuboid(&mut mesh, (-half).extend(0.0), half.extend(0.008));
        layout.draw(&mesh, at, yaw, 0.0);
    }
}
