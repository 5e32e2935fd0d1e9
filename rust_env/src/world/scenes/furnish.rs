//! Rules that furnish a room by its purpose: groups that belong together, most pieces at the walls
//! (ProcTHOR, Deitke et al. 2022: 70 % on the edge, 60 % in semantic groups), then clutter.
use super::draw::{Draw, Random};
use super::fixtures::{self as fix, Unit};
use super::footprint::{area, border_distance, edges, Block};
use super::furniture as make;
use super::layout::{Layout, Piece, Placed, Use};
use super::objects as small;
use super::solid;
use crate::geometry::Mesh;
use glam::Vec2;
use std::f32::consts::{FRAC_PI_2, PI};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Purpose {
    Living,
    Bedroom,
    Kitchen,
    Dining,
    Study,
    Bathroom,
    Hall,
    Office,
    Meeting,
    Storage,
    /// Of a shop.
    Sales,
    Cafe,
    Warehouse,
}

/// Keeps a disc free where the camera starts: a place with room for `radius`, or else the best place found.
/// Was there room?
pub(super) fn reserve_start(layout: &mut Layout, radius: f32, random: &mut Random) -> bool {
    let mut best = (layout.point(random), 0.0);
    for i in 0..150 {
        let p = layout.point(random);
        if border_distance(&layout.outline, p) <= best.1 {
            continue;
        }
        let room = layout.solid.iter().map(|b| b.footprint.distance(p));
        let room = room.fold(layout.clearance(p, 1.0), f32::min);
        if room > best.1 {
            best = (p, room);
        }
        // Any place with room will do once a few were compared; the disc need not be in the middle.
        if i >= 6 && best.1 > radius + 0.01 {
            break;
        }
    }
    layout.clear.push((best.0, radius.min(best.1)));
    best.1 > radius
}

/// Puts everything into the room that its purpose asks for and keeps a disc of radius `free` clear
/// where a camera may start.
pub(super) fn furnish(layout: &mut Layout, purpose: Purpose, free: f32, random: &mut Random) {
    layout.fullness = random.between(0.35, 0.95);
    let size = area(&layout.outline);
    // The groups first: a sofa should face its television. Only a room that is then too full gets the disc first.
    let bare = layout.clone();
    let has_room = (0..3).any(|_| {
        layout.clone_from(&bare);
        groups(layout, purpose, size, random);
        reserve_start(layout, free, random)
    });
    if !has_room {
        layout.clone_from(&bare);
        reserve_start(layout, free, random);
        groups(layout, purpose, size, random);
    }
    if size > 7.0 && purpose != Purpose::Bathroom {
        if random.chance(0.7) {
            put_along_walls(layout, &[Wall::Plant], random);
        }
        if random.chance(0.4) {
            put_along_walls(layout, &[Wall::Lamp], random);
        }
    }
    fill_up(layout, purpose, size, random);
    hang_things(layout, purpose, size, random);
    floor_clutter(layout, purpose, size, random);
}

fn groups(layout: &mut Layout, purpose: Purpose, size: f32, random: &mut Random) {
    match purpose {
        Purpose::Living => living(layout, size, random),
        Purpose::Bedroom => bedroom(layout, size, random),
        Purpose::Kitchen => {
            kitchen_run(layout, random);
            if size > 9.0 {
                dining_group(layout, 4, random);
            }
        }
        Purpose::Dining => {
            dining_group(layout, if size > 16.0 { 8 } else { 6 }, random);
            put_along_walls(layout, &[Wall::Dresser, Wall::Shelf], random);
        }
        Purpose::Study => {
            desk_group(layout, random);
            put_along_walls(layout, &[Wall::Shelf, Wall::Shelf, Wall::Dresser], random);
            if size > 12.0 {
                armchair_corner(layout, random);
            }
        }
        Purpose::Office => {
            for _ in 0..(size / 8.5).round().clamp(1.0, 8.0) as usize {
                desk_group(layout, random);
            }
            put_along_walls(layout, &[Wall::Shelf, Wall::Cabinet], random);
        }
        Purpose::Meeting => meeting(layout, size, random),
        Purpose::Bathroom => bathroom(layout, random),
        Purpose::Hall => {
            for _ in 0..(size / 12.0).ceil() as usize {
                put_along_walls(layout, &[Wall::Coats, Wall::Low, Wall::Plant], random);
            }
        }
        Purpose::Storage => {
            let shelves = [Wall::Rack, Wall::Rack, Wall::Rack, Wall::Wardrobe];
            put_along_walls(layout, &shelves, random);
        }
        // These have rules of their own beside their plans.
        Purpose::Sales | Purpose::Cafe | Purpose::Warehouse => {}
    }
}

/// Adds pieces until a share of the floor, drawn for this room, is covered: furniture on 10-25 % of the floor is
/// what real scenes show.
fn fill_up(layout: &mut Layout, purpose: Purpose, size: f32, r: &mut Random) {
    let target = match purpose {
        Purpose::Hall | Purpose::Bathroom => r.between(0.06, 0.16),
        Purpose::Office | Purpose::Meeting => r.between(0.08, 0.2),
        _ => r.between(0.12, 0.25),
    };
    let kinds: &[Wall] = match purpose {
        Purpose::Living => &[
            Wall::Shelf,
            Wall::Side,
            Wall::Seat,
            Wall::Plant,
            Wall::Dresser,
        ],
        Purpose::Bedroom => &[
            Wall::Shelf,
            Wall::Wardrobe,
            Wall::Dresser,
            Wall::Seat,
            Wall::Side,
        ],
        Purpose::Kitchen | Purpose::Dining => &[Wall::Low, Wall::Side, Wall::Dresser, Wall::Seat],
        Purpose::Study => &[
            Wall::Shelf,
            Wall::Shelf,
            Wall::Side,
            Wall::Seat,
            Wall::Cabinet,
        ],
        Purpose::Office | Purpose::Meeting => &[Wall::Shelf, Wall::Cabinet, Wall::Side, Wall::Seat],
        Purpose::Bathroom => &[Wall::Low, Wall::Laundry],
        Purpose::Hall => &[Wall::Low, Wall::Plant, Wall::Seat, Wall::Cabinet],
        _ => &[Wall::Rack, Wall::Rack, Wall::Laundry, Wall::Cartons],
    };
    for _ in 0..30 {
        if layout.covered > target * size {
            break;
        }
        let kind = r.one_of(kinds);
        // Three pieces of ten stand free.
        if r.chance(0.3) && matches!(kind, Wall::Side | Wall::Seat | Wall::Plant | Wall::Cartons) {
            let piece = wall_piece(kind, r);
            layout.anywhere(&piece, 6, r);
        } else {
            let piece = wall_piece(kind, r);
            layout.against_wall(&piece, 0.0, 8, r);
        }
    }
}

/// What is simply put somewhere at a wall.
#[derive(Clone, Copy)]
enum Wall {
    Shelf,
    Rack,
    Dresser,
    Wardrobe,
    Cabinet,
    Low,
    Coats,
    Plant,
    Lamp,
    /// A small table with things on it.
    Side,
    /// A chair, an armchair or a bench.
    Seat,
    Laundry,
    /// A stack of boxes.
    Cartons,
}

fn put_along_walls(layout: &mut Layout, what: &[Wall], r: &mut Random) {
    let size = area(&layout.outline);
    for kind in what {
        if layout.covered > 0.2 * size || !r.chance(0.65) {
            continue;
        }
        let piece = wall_piece(*kind, r);
        layout.against_wall(&piece, 0.0, 14, r);
    }
}

fn wall_piece(kind: Wall, r: &mut Random) -> Piece {
    match kind {
        Wall::Shelf => {
            let (w, d) = (r.between(0.6, 1.3), r.between(0.26, 0.4));
            let tall = r.between(0.9, 2.1);
            make::shelf(r, w, d, tall, Use::Shelf)
        }
        Wall::Rack => {
            let (w, d) = (r.between(0.9, 1.5), r.between(0.4, 0.5));
            make::shelf(r, w, d, 1.9, Use::Cupboard)
        }
        Wall::Dresser => make::dresser(r),
        Wall::Wardrobe => make::wardrobe(r),
        Wall::Cabinet => {
            let size = [
                r.between(0.4, 1.0),
                r.between(0.4, 0.5),
                r.between(0.7, 1.9),
            ];
            let (columns, rows) = (r.count(1, 2), r.count(2, 4));
            make::cupboard(r, size, columns, rows)
        }
        Wall::Low => {
            let (w, d, h) = (
                r.between(0.6, 1.0),
                r.between(0.25, 0.35),
                r.between(0.5, 0.9),
            );
            make::shelf(r, w, d, h, Use::Cupboard)
        }
        Wall::Coats => fix::coat_rack(r),
        Wall::Plant => fix::plant(r),
        Wall::Lamp => fix::floor_lamp(r),
        Wall::Side => {
            let (w, d, h) = (
                r.between(0.4, 0.9),
                r.between(0.35, 0.6),
                r.between(0.5, 0.8),
            );
            make::table(r, w, d, h, Use::Coffee)
        }
        Wall::Seat => match r.count(0, 2) {
            0 => make::sofa(r, 1),
            1 => make::chair(r),
            _ => make::stool(r, 0.45),
        },
        Wall::Laundry => small::laundry(r),
        Wall::Cartons => small::carton_stack(r),
    }
}

fn living(layout: &mut Layout, size: f32, r: &mut Random) {
    let seats = if size > 16.0 {
        r.count(2, 4)
    } else {
        r.count(2, 3)
    };
    let sofa = make::sofa(r, seats);
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
                let chair = make::sofa(r, 1);
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

fn bedroom(layout: &mut Layout, size: f32, r: &mut Random) {
    let wide = size > 11.0 && r.chance(0.7);
    let width = if wide {
        r.between(1.4, 1.85)
    } else {
        r.between(0.9, 1.2)
    };
    let bed = make::bed(r, width);
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

fn bathroom(layout: &mut Layout, r: &mut Random) {
    if r.chance(0.7) {
        let tub = fix::bathtub(r);
        layout.against_wall(&tub, 0.0, 30, r);
    }
    let basin = fix::washbasin(r);
    if let Some(basin) = layout.against_wall(&basin, 0.0, 30, r) {
        let mirror = fix::picture(r, basin.half.x * 1.8, 0.7);
        let at = basin.point(Vec2::new(0.0, mirror.half.y - basin.half.y - 0.01));
        layout.put(&mirror, at, basin.yaw, 1.2, r);
    }
    let toilet = fix::toilet(r);
    layout.against_wall(&toilet, 0.0, 40, r);
    if r.chance(0.5) {
        let washer = fix::washing_machine(r);
        layout.against_wall(&washer, 0.0, 20, r);
    }
    put_along_walls(layout, &[Wall::Low], r);
}

fn meeting(layout: &mut Layout, size: f32, r: &mut Random) {
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
        let chair = make::chair(&mut style.clone());
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
            make::office_chair(&mut style.clone())
        } else {
            make::chair(&mut style.clone())
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
        make::office_chair(r)
    } else {
        make::chair(r)
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

fn armchair_corner(layout: &mut Layout, r: &mut Random) {
    let chair = make::sofa(r, 1);
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

fn rug(layout: &mut Layout, at: Vec2, yaw: f32, r: &mut Random) {
    let half = Vec2::new(r.between(0.8, 1.3), r.between(0.6, 0.95));
    let block = Block::new(at, half, yaw, [0.0, 0.008]);
    // A rug may lie under anything that stands on legs, but not reach into a wall.
    if block
        .footprint
        .corners()
        .iter()
        .all(|c| super::footprint::contains(&layout.outline, *c))
    {
        let mut mesh = Mesh::default();
        solid::cuboid(&mut mesh, (-half).extend(0.0), half.extend(0.008));
        layout.draw(&mesh, at, yaw, 0.0);
        layout.instances += 1;
    }
}

/// Pictures, boards, radiators, lamps at the ceiling.
pub(super) fn hang_things(layout: &mut Layout, purpose: Purpose, size: f32, r: &mut Random) {
    if r.chance(0.7) {
        let radiator = fix::radiator(r);
        layout.against_wall(&radiator, 0.0, 10, r);
    }
    let boards = match purpose {
        Purpose::Hall | Purpose::Storage => r.count(0, 1),
        _ => r.count(0, 2),
    };
    for _ in 0..boards {
        let (board, lift) = (fix::wall_board(r), r.between(1.1, 1.7));
        layout.against_wall(&board, lift, 8, r);
    }
    for _ in 0..r.count(1, 2 + (size / 7.0) as usize) {
        let (w, h) = (r.between(0.25, 1.0), r.between(0.3, 0.8));
        let (picture, lift) = (fix::picture(r, w, h), r.between(1.15, 1.5));
        layout.against_wall(&picture, lift, 6, r);
    }
    if layout.ceiling && layout.height > 2.35 {
        let drop = layout.height - 2.22;
        let lamp = fix::hanging_lamp(r, r.clone().between(0.2, drop).min(drop));
        let lift = layout.height - lamp.height - 0.003;
        for _ in 0..6 {
            let at = layout.point(r);
            if border_distance(&layout.outline, at) > 0.9
                && layout.put(&lamp, at, 0.0, lift, r).is_some()
            {
                break;
            }
        }
    }
}

/// Things that lie or stand about: boxes, shoes, bags, toys; rather at the walls than in the middle.
pub(super) fn floor_clutter(layout: &mut Layout, purpose: Purpose, size: f32, r: &mut Random) {
    let density = match purpose {
        Purpose::Storage => 0.9,
        Purpose::Bathroom | Purpose::Hall | Purpose::Meeting | Purpose::Office => 0.25,
        _ => 0.45,
    };
    let count = (density * size * (0.4 + layout.fullness) * r.between(0.5, 1.5)) as usize;
    // A real room holds 25 things or more.
    let least = match purpose {
        Purpose::Hall | Purpose::Bathroom | Purpose::Sales | Purpose::Cafe => 0,
        Purpose::Office | Purpose::Meeting => (18.0f32.min(1.2 * size)) as usize,
        _ => (25.0f32.min(2.0 * size)) as usize,
    };
    for i in 0..40 {
        if i >= count.min(24) && layout.instances >= least {
            break;
        }
        let piece = floor_thing(purpose, r);
        if r.chance(0.6) {
            layout.against_wall(&piece, 0.0, 5, r);
        } else {
            layout.anywhere(&piece, 5, r);
        }
    }
}

fn floor_thing(purpose: Purpose, r: &mut Random) -> Piece {
    let is_home = !matches!(
        purpose,
        Purpose::Office | Purpose::Meeting | Purpose::Storage
    );
    let weights = if is_home {
        [1.5, 1.5, 2.0, 1.5, 1.0, 0.7, 1.0, 1.0, 1.0, 0.5, 1.0, 0.6]
    } else {
        [3.0, 3.0, 0.1, 1.5, 1.5, 0.2, 0.1, 0.1, 2.0, 0.4, 0.5, 0.4]
    };
    match r.weighted(&weights) {
        0 => small::open_box(r),
        1 => small::carton(r, 0.2, 0.5),
        2 => fix::shoes(r),
        3 => small::bag(r, 12),
        4 => fix::bin(r),
        5 => fix::suitcase(r),
        6 => small::clothes(r, 12),
        7 => small::sphere(r, 12),
        8 => small::book_stack(r),
        9 => fix::fan(r),
        10 => small::basket(r, 14),
        _ => make::stool(r, 0.45),
    }
}
