//! Small things and the rules that put them on surfaces: real rooms hold 25-60 objects, most of them small.
use super::crockery;
use super::draw::{Draw, Random};
use super::layout::{Layout, Piece, Spot, Surface, Use};
use super::objects as make;
use glam::Vec2;

/// Fills a surface with what belongs there.
pub(super) fn dress(layout: &mut Layout, spot: &Spot, random: &mut Random) {
    let surface = &spot.surface;
    match surface.usage {
        Use::Desk => work_place(layout, spot, random),
        Use::Goods => return goods(layout, spot, random),
        Use::Pallet => return cartons(layout, spot, random),
        _ => {}
    }
    let half = surface.footprint.half;
    let area = 4.0 * half.x * half.y;
    // Things per square metre; shelves are narrow and full.
    let density = match surface.usage {
        Use::Shelf => 14.0,
        Use::Counter | Use::Desk => 8.0,
        Use::Dining => 6.0,
        Use::Coffee | Use::Bedside | Use::Bathroom => 10.0,
        Use::Seat => 1.5,
        _ => 6.0,
    };
    let wanted = density * area * layout.fullness * random.between(0.3, 1.7);
    let wanted = wanted as usize + usize::from(random.chance(wanted.fract()));
    for _ in 0..wanted.min(14) {
        let piece = thing(surface, random, layout.segments);
        put_somewhere(layout, &piece, spot, 6, random);
    }
}

/// One small thing that suits the surface.
pub(super) fn thing(surface: &Surface, r: &mut Random, n: u32) -> Piece {
    let room = surface.footprint.half * 2.0;
    let high = surface.headroom;
    match surface.usage {
        Use::Dining => match r.weighted(&[3.0, 3.0, 2.0, 2.0, 1.0, 1.0, 1.0, 1.0, 1.0]) {
            0 => crockery::plate(r, n),
            1 => crockery::mug(r, n),
            2 => crockery::bowl(r, n),
            3 => crockery::bottle(r, n),
            4 => crockery::vase(r, n),
            5 => crockery::fruit_bowl(r, n),
            6 => crockery::glass(r, n),
            7 => make::book_stack(r),
            _ => crockery::pot(r, n),
        },
        Use::Coffee => match r.weighted(&[3.0, 2.0, 1.0, 1.0, 1.0, 1.0]) {
            0 => make::book_stack(r),
            1 => crockery::mug(r, n),
            2 => crockery::bowl(r, n),
            3 => crockery::vase(r, n),
            4 => make::carton(r, 0.08, 0.18),
            _ => crockery::bottle(r, n),
        },
        Use::Desk => match r.weighted(&[3.0, 2.0, 2.0, 1.0, 1.0, 2.0]) {
            0 => make::book_stack(r),
            1 => crockery::mug(r, n),
            2 => make::pen_pot(r, n),
            3 => make::table_lamp(r, n),
            4 => make::small_plant(r, n),
            _ => make::carton(r, 0.08, 0.25),
        },
        Use::Bedside => match r.weighted(&[3.0, 2.0, 2.0, 1.0]) {
            0 => make::table_lamp(r, n),
            1 => make::book_stack(r),
            2 => crockery::glass(r, n),
            _ => make::picture_frame(r),
        },
        Use::Counter => match r.weighted(&[2.0, 2.0, 2.0, 1.0, 1.0, 2.0, 1.0, 1.0]) {
            0 => crockery::bottle(r, n),
            1 => crockery::pot(r, n),
            2 => crockery::tin(r, n),
            3 => make::toaster(r),
            4 => crockery::kettle(r, n),
            5 => make::carton(r, 0.1, 0.3),
            6 => crockery::fruit_bowl(r, n),
            _ => crockery::mug(r, n),
        },
        Use::Shelf => match r.weighted(&[5.0, 1.5, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.7]) {
            0 => make::book_row(r, room, high),
            1 => make::carton(r, 0.1, high.min(0.3)),
            2 => crockery::vase(r, n),
            3 => make::small_plant(r, n),
            4 => make::picture_frame(r),
            5 => make::basket(r, n),
            6 => make::sphere(r, n),
            7 => make::book_stack(r),
            _ => make::speaker(r, n),
        },
        Use::Bathroom => match r.weighted(&[3.0, 1.0, 1.0, 1.0]) {
            0 => crockery::bottle(r, n),
            1 => make::pen_pot(r, n),
            2 => crockery::tin(r, n),
            _ => make::towels(r, n),
        },
        Use::Seat => match r.weighted(&[2.0, 2.0, 1.0]) {
            0 => make::cushion(r, n),
            1 => make::clothes(r, n),
            _ => make::bag(r, n),
        },
        Use::Cupboard | Use::Goods | Use::Pallet => {
            match r.weighted(&[2.0, 2.0, 1.0, 1.0, 1.0, 1.0, 1.0]) {
                0 => make::carton(r, 0.15, 0.4),
                1 => make::picture_frame(r),
                2 => crockery::vase(r, n),
                3 => make::small_plant(r, n),
                4 => make::book_stack(r),
                5 => make::table_lamp(r, n),
                _ => make::basket(r, n),
            }
        }
    }
}

/// Somewhere on the surface, roughly square to it, not over the edge.
pub(super) fn put_somewhere(
    layout: &mut Layout,
    piece: &Piece,
    spot: &Spot,
    tries: usize,
    random: &mut Random,
) -> bool {
    let surface = &spot.surface;
    if piece.height > surface.headroom {
        return false;
    }
    (0..tries).any(|_| {
        let turn = if random.chance(0.8) {
            random.between(-0.2, 0.2)
        } else {
            random.heading()
        };
        // On a narrow shelf a thing stands square to the board or not at all.
        let (turn, reach) = match surface.usage {
            Use::Shelf => (turn.clamp(-0.2, 0.2) * 0.2, piece.half + 0.01),
            _ => {
                let (s, c) = turn.sin_cos();
                let (s, c) = (s.abs(), c.abs());
                let h = piece.half;
                (turn, Vec2::new(h.x * c + h.y * s, h.x * s + h.y * c))
            }
        };
        let slack = surface.footprint.half - reach;
        if slack.min_element() < 0.0 {
            return false;
        }
        let local = Vec2::new(
            random.between(-slack.x, slack.x),
            random.between(-slack.y, slack.y),
        );
        layout.put_on(piece, spot, spot.point(local), turn, 0.0)
    })
}

/// Monitor or laptop at the back, keyboard in front of it.
fn work_place(layout: &mut Layout, spot: &Spot, r: &mut Random) {
    let surface = &spot.surface;
    let f = surface.footprint;
    let slide = r.between(-0.3, 0.3) * f.half.x;
    let mut put = |piece: &Piece, x: f32, y: f32, turn: f32| {
        let slack = (f.half - piece.half).max(Vec2::ZERO);
        let (x, y) = (x.clamp(-slack.x, slack.x), y.clamp(-slack.y, slack.y));
        layout.put_on(piece, spot, spot.point(Vec2::new(x, y)), turn, 0.0);
    };
    if r.chance(0.65) {
        let screens = if f.half.x > 0.75 && r.chance(0.3) {
            2
        } else {
            1
        };
        for i in 0..screens {
            let x = slide + (i as f32 - 0.5 * (screens - 1) as f32) * 0.66;
            put(
                &make::monitor(r),
                x,
                -f.half.y + 0.14,
                r.between(-0.15, 0.15),
            );
        }
        put(&make::keyboard(r), slide, 0.12, r.between(-0.1, 0.1));
    } else if r.chance(0.7) {
        put(&make::laptop(r), slide, 0.0, r.between(-0.3, 0.3));
    }
}

/// Rows of equal goods side by side, as shops put them; here and there a gap.
fn goods(layout: &mut Layout, spot: &Spot, r: &mut Random) {
    let surface = &spot.surface;
    let f = surface.footprint;
    let mut x = -f.half.x + 0.01;
    while x < f.half.x - 0.06 {
        if r.chance((1.0 - layout.fullness) * 0.6) {
            x += r.between(0.05, 0.25);
            continue;
        }
        let piece = match r.weighted(&[4.0, 1.5, 1.5, 1.0]) {
            0 => make::carton(r, 0.09, surface.headroom.min(0.34)),
            1 => crockery::bottle(r, layout.segments.min(8)),
            2 => crockery::tin(r, layout.segments.min(8)),
            _ => make::book_row(r, f.half * 2.0, surface.headroom),
        };
        if piece.height > surface.headroom || piece.half.y > f.half.y {
            x += 0.05;
            continue;
        }
        for _ in 0..r.count(1, 4) {
            if x + 2.0 * piece.half.x > f.half.x {
                break;
            }
            let y = f.half.y - piece.half.y - r.between(0.0, 0.06).min(f.half.y - piece.half.y);
            let at = spot.point(Vec2::new(x + piece.half.x, y));
            layout.put_on(&piece, spot, at, 0.0, 0.0);
            x += 2.0 * piece.half.x + 0.008;
        }
    }
}

/// A load of cartons in layers, as on a pallet; the upper layers are not always complete.
fn cartons(layout: &mut Layout, spot: &Spot, r: &mut Random) {
    let surface = &spot.surface;
    let f = surface.footprint;
    if !r.chance(0.35 + 0.6 * layout.fullness) {
        return;
    }
    let (across, deep) = (r.count(1, 3), r.count(1, 2));
    let size = Vec2::new(2.0 * f.half.x / across as f32, 2.0 * f.half.y / deep as f32);
    let tall = r.between(0.22, 0.5);
    let layers = ((surface.headroom - 0.05) / tall) as usize;
    let layers = r.count(1, layers.clamp(1, 4));
    for layer in 0..layers {
        if (layer + 1) as f32 * tall > surface.headroom {
            break;
        }
        let is_top = layer + 1 == layers;
        for i in 0..across {
            for j in 0..deep {
                if is_top && layer > 0 && r.chance(0.3) {
                    continue;
                }
                let play = r.between(0.01, 0.03);
                let piece = make::box_of(size.x - play, size.y - play, tall - 0.002);
                let local = Vec2::new(
                    (i as f32 + 0.5) * size.x - f.half.x,
                    (j as f32 + 0.5) * size.y - f.half.y,
                );
                let turn = r.between(-0.01, 0.01);
                let lift = layer as f32 * tall;
                layout.put_on(&piece, spot, spot.point(local), turn, lift);
            }
        }
    }
}
