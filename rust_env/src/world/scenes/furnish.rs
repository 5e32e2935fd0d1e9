//! Rules that furnish a room by its purpose: groups that belong together, most pieces at the walls
//! (ProcTHOR, Deitke et al. 2022: 70 % on the edge, 60 % in semantic groups), then clutter.
use super::draw::{Draw, Random};
use super::fixtures as fix;
use super::footprint::{area, border_distance};
use super::furniture as make;
use super::groups;
use super::layout::{Layout, Piece, Use};
use super::objects as small;
use super::seats;

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
        Purpose::Living => groups::living(layout, size, random),
        Purpose::Bedroom => groups::bedroom(layout, size, random),
        Purpose::Kitchen => {
            groups::kitchen_run(layout, random);
            if size > 9.0 {
                groups::dining_group(layout, 4, random);
            }
        }
        Purpose::Dining => {
            groups::dining_group(layout, if size > 16.0 { 8 } else { 6 }, random);
            put_along_walls(layout, &[Wall::Dresser, Wall::Shelf], random);
        }
        Purpose::Study => {
            groups::desk_group(layout, random);
            put_along_walls(layout, &[Wall::Shelf, Wall::Shelf, Wall::Dresser], random);
            if size > 12.0 {
                groups::armchair_corner(layout, random);
            }
        }
        Purpose::Office => {
            for _ in 0..(size / 8.5).round().clamp(1.0, 8.0) as usize {
                groups::desk_group(layout, random);
            }
            put_along_walls(layout, &[Wall::Shelf, Wall::Cabinet], random);
        }
        Purpose::Meeting => groups::meeting(layout, size, random),
        Purpose::Bathroom => groups::bathroom(layout, random),
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
pub(super) enum Wall {
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

pub(super) fn put_along_walls(layout: &mut Layout, what: &[Wall], r: &mut Random) {
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
            0 => seats::sofa(r, 1),
            1 => seats::chair(r),
            _ => seats::stool(r, 0.45),
        },
        Wall::Laundry => small::laundry(r),
        Wall::Cartons => small::carton_stack(r),
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
        _ => seats::stool(r, 0.45),
    }
}
