//! "home": a flat of one to eight rooms; areas and proportions after ProcTHOR's floor plans (Deitke et al. 2022).
use super::draft::Draft;
use super::draw::{Draw, Random};
use super::floorplan::{with_ways, Cell, Plan};
use super::furnish::Purpose;
use glam::Vec2;

pub(super) fn home(random: &mut Random) -> Draft {
    let mut plan = plan(random);
    // Now and then a room is cut off by walls too short for a door: draw another plan.
    for _ in 0..20 {
        if plan.connect(0.12, random) {
            break;
        }
        plan = self::plan(random);
    }
    plan.enter(
        |c| matches!(c.purpose, Purpose::Hall | Purpose::Living),
        random,
    );
    plan.windows(3.2, random);
    plan.build(random, with_ways)
}

fn plan(r: &mut Random) -> Plan {
    let rooms = 1 + r.weighted(&[1.0, 1.5, 2.5, 3.0, 2.5, 2.0, 1.0, 1.0]);
    let size = rooms as f32 * r.between(15.0, 26.0) + 8.0;
    let aspect = r.between(1.0, 1.7);
    let max = Vec2::new((size * aspect).sqrt(), (size / aspect).sqrt());
    let whole = Cell::new(Vec2::ZERO, max, Purpose::Bedroom);
    let mut cells = if rooms >= 4 && r.chance(0.6) {
        with_hall(whole, rooms - 1, r)
    } else {
        divide(whole, rooms, r)
    };
    if cells.len() >= 5 && r.chance(0.3) {
        drop_corner(&mut cells, max);
    }
    name_rooms(&mut cells, r);
    Plan::new(cells, r)
}

/// A hall through the whole flat, rooms on both sides.
fn with_hall(whole: Cell, rooms: usize, r: &mut Random) -> Vec<Cell> {
    let width = r.between(1.3, 1.8);
    let depth = whole.size().y;
    let low = r.between(0.42, 0.58) * (depth - width);
    let [below, rest] = whole.split(false, low / depth);
    let [mut hall, above] = rest.split(false, width / (depth - low));
    hall.purpose = Purpose::Hall;
    let first = rooms.div_ceil(2);
    let mut cells = vec![hall];
    cells.extend(divide(below, first, r));
    cells.extend(divide(above, rooms - first, r));
    cells
}

/// Splits the largest cell across its longer side until there are `count`.
fn divide(whole: Cell, count: usize, r: &mut Random) -> Vec<Cell> {
    let mut cells = vec![whole];
    while cells.len() < count {
        let largest = (0..cells.len())
            .max_by(|a, b| cells[*a].area().total_cmp(&cells[*b].area()))
            .unwrap_or(0);
        let cell = cells.remove(largest);
        let along_x = cell.size().x > cell.size().y;
        cells.extend(cell.split(along_x, r.between(0.36, 0.64)));
    }
    cells
}

/// Leaves out the smallest cell at a corner of the plan: the flat becomes an L.
fn drop_corner(cells: &mut Vec<Cell>, max: Vec2) {
    let at_corner = |c: &Cell| {
        (c.min.x < 1e-3 || c.max.x > max.x - 1e-3) && (c.min.y < 1e-3 || c.max.y > max.y - 1e-3)
    };
    let smallest = (0..cells.len())
        .filter(|i| cells[*i].purpose != Purpose::Hall && at_corner(&cells[*i]))
        .min_by(|a, b| cells[*a].area().total_cmp(&cells[*b].area()));
    if let Some(i) = smallest {
        cells.remove(i);
    }
}

/// The largest room is the living room, the smallest the bathroom, one a kitchen; the others as they come.
fn name_rooms(cells: &mut [Cell], r: &mut Random) {
    let mut order: Vec<usize> = (0..cells.len())
        .filter(|i| cells[*i].purpose != Purpose::Hall)
        .collect();
    order.sort_by(|a, b| cells[*b].area().total_cmp(&cells[*a].area()));
    let mut names = vec![Purpose::Living];
    let small = order.len();
    for i in 1..small {
        let room = &cells[order[i]];
        names.push(match i {
            _ if i + 1 == small && small > 2 && room.area() < 16.0 => Purpose::Bathroom,
            1 if small == 2 => r.one_of(&[Purpose::Bedroom, Purpose::Kitchen]),
            2 => Purpose::Kitchen,
            1 | 3 => Purpose::Bedroom,
            _ if room.size().min_element() < 2.0 => Purpose::Storage,
            _ => r.one_of(&[
                Purpose::Bedroom,
                Purpose::Study,
                Purpose::Dining,
                Purpose::Storage,
                Purpose::Bathroom,
            ]),
        });
    }
    for (i, name) in order.into_iter().zip(names) {
        cells[i].purpose = name;
    }
}
