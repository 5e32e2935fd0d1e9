//! "room": one furnished room; a rectangle, an L, or with 45-degree corners.
use super::draft::{Draft, SLAB};
use super::draw::{Draw, Random};
use super::footprint::{edges, offset};
use super::furnish::{furnish, Purpose};
use super::layout::Layout;
use super::solid;
use super::walls::{fit_opening, hang_leaf, wall, Opening};
use glam::Vec2;

/// Radius of the disc that stays free around the first start, metres.
pub(super) const FREE_RADIUS: f32 = 1.02;

pub(super) fn room(random: &mut Random) -> Draft {
    let purpose = [
        Purpose::Living,
        Purpose::Bedroom,
        Purpose::Kitchen,
        Purpose::Dining,
        Purpose::Study,
        Purpose::Office,
        Purpose::Meeting,
        Purpose::Storage,
    ][random.weighted(&[4.0, 4.0, 2.0, 2.0, 2.0, 2.0, 1.0, 1.0])];
    let outline = outline(purpose, random);
    let floor = random.between(0.01, 0.05);
    // Mostly 2.4-3 m, now and then higher.
    let height = 2.4 + 1.2 * random.between(0.0, 1.0).powi(2);
    let thickness = random.between(0.12, 0.3);
    let mut draft = Draft {
        floor,
        ..Draft::default()
    };
    let mut layout = Layout::new(outline, floor, height);
    layout.ceiling = random.chance(0.5);

    let outer = offset(&layout.outline, thickness);
    let openings = openings(&layout.outline, random);
    let n = outer.len();
    let walls: Vec<(Vec2, Vec2)> = edges(&layout.outline).collect();
    for (i, (a, b)) in walls.into_iter().enumerate() {
        let back = [outer[i], outer[(i + 1) % n]];
        wall(&mut draft.shell, [a, b], back, floor, height, &openings[i]);
        for opening in &openings[i] {
            fit_opening(&mut layout, [a, b], opening, random);
        }
    }
    let walls: Vec<(Vec2, Vec2)> = edges(&layout.outline).collect();
    for ((a, b), openings) in walls.into_iter().zip(&openings) {
        for opening in openings {
            hang_leaf(&mut layout, [a, b], opening, random);
        }
    }
    solid::prism(&mut draft.shell, &outer, floor - SLAB, floor);
    if layout.ceiling {
        let top = floor + height;
        solid::prism(&mut draft.shell, &outer, top, top + SLAB);
    }
    furnish(&mut layout, purpose, FREE_RADIUS, random);
    draft.rooms.push(layout);
    draft.find_starts(random);
    draft
}

fn outline(purpose: Purpose, r: &mut Random) -> Vec<Vec2> {
    let (least, most) = match purpose {
        Purpose::Living => (18.0, 38.0),
        Purpose::Bedroom | Purpose::Kitchen | Purpose::Study => (14.0, 27.0),
        _ => (15.0, 30.0),
    };
    let size = r.between(least, most);
    let aspect = r.between(1.0, 1.7);
    let (w, d) = ((size * aspect).sqrt(), (size / aspect).sqrt());
    let p = Vec2::new;
    match r.weighted(&[6.0, 2.0, 2.0]) {
        1 => {
            // One to two corners cut at 45 degrees.
            let two = r.chance(0.4);
            let (c, e) = (r.between(0.6, 1.4), r.between(0.5, 1.2));
            let mut corners = vec![p(0.0, 0.0), p(w, 0.0), p(w, d - c), p(w - c, d)];
            if two {
                corners.extend([p(e, d), p(0.0, d - e)]);
            } else {
                corners.push(p(0.0, d));
            }
            corners
        }
        2 => {
            // An L: the missing corner leaves both legs at least 1.8 m wide.
            let x = w - r.between(0.8, (w - 1.8).clamp(0.9, 0.5 * w));
            let y = d - r.between(0.8, (d - 1.8).clamp(0.9, 0.5 * d));
            vec![p(0.0, 0.0), p(w, 0.0), p(w, y), p(x, y), p(x, d), p(0.0, d)]
        }
        _ => vec![p(0.0, 0.0), p(w, 0.0), p(w, d), p(0.0, d)],
    }
}

/// One or two doors, up to three windows, in one room of eight a side that is open to the next room.
fn openings(outline: &[Vec2], r: &mut Random) -> Vec<Vec<Opening>> {
    let lengths: Vec<f32> = edges(outline).map(|(a, b)| a.distance(b)).collect();
    let mut openings = vec![Vec::new(); lengths.len()];
    let mut cut = |make: &mut dyn FnMut(f32, &mut Random) -> Opening, r: &mut Random| {
        for _ in 0..20 {
            let i = r.weighted(&lengths);
            let opening = make(lengths[i], r);
            let margin = opening.width / 2.0 + 0.2;
            let at = r.between(margin, lengths[i] - margin);
            let opening = Opening { at, ..opening };
            if lengths[i] > 2.0 * margin && opening.is_apart(&openings[i]) {
                openings[i].push(opening);
                return;
            }
        }
    };
    if r.chance(0.12) {
        let (share, top) = (r.between(0.4, 0.8), r.between(2.0, 2.4));
        cut(&mut |l, _| Opening::passage(0.0, l * share, top), r);
    }
    for _ in 0..r.count(1, 2) {
        cut(&mut |_, r| Opening::door(0.0, r), r);
    }
    for _ in 0..r.count(0, 3) {
        cut(
            &mut |_, r| {
                let width = r.between(0.8, 1.75);
                Opening::window(0.0, width, r)
            },
            r,
        );
    }
    openings
}
