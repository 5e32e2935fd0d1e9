//! "office": rows of rooms of 10-15 m2 along one or two corridors, as in willowgarage and in hospitals.
use super::draft::Draft;
use super::draw::{Draw, Random};
use super::floorplan::{with_ways, Cell, Plan};
use super::furnish::Purpose;
use glam::Vec2;

pub(super) fn office(random: &mut Random) -> Draft {
    let mut plan = Plan::new(cells(random), random);
    // Rows of cells along corridors always connect: every room shares its whole front with one.
    plan.connect(0.1, random);
    plan.enter(|c| c.purpose == Purpose::Hall, random);
    plan.windows(3.0, random);
    plan.build(random, with_ways)
}

fn cells(r: &mut Random) -> Vec<Cell> {
    let length = r.between(10.0, 17.0);
    let corridors = if r.chance(0.35) { 2 } else { 1 };
    let mut cells = Vec::new();
    let mut y = 0.0;
    for _ in 0..corridors {
        let (near, hall, far) = (
            r.between(3.8, 5.2),
            r.between(1.7, 2.6),
            r.between(3.8, 5.2),
        );
        let p = Vec2::new;
        let (y1, y2, y3) = (y + near, y + near + hall, y + near + hall + far);
        cells.push(Cell::new(p(0.0, y1), p(length, y2), Purpose::Hall));
        row(&mut cells, y, y1, length, r);
        // In three offices of ten the far side of a corridor is one open-plan room.
        if r.chance(0.3) {
            cells.push(Cell::new(p(0.0, y2), p(length, y3), Purpose::Office));
        } else {
            row(&mut cells, y2, y3, length, r);
        }
        y = y3;
    }
    if corridors == 2 {
        // A short corridor joins both at one end.
        let width = r.between(1.6, 2.2);
        let (from, to) = (Vec2::new(length, 0.0), Vec2::new(length + width, y));
        cells.push(Cell::new(from, to, Purpose::Hall));
    }
    cells
}

fn row(cells: &mut Vec<Cell>, y0: f32, y1: f32, length: f32, r: &mut Random) {
    let mut x = 0.0;
    while x < length {
        let purpose = [
            Purpose::Office,
            Purpose::Meeting,
            Purpose::Study,
            Purpose::Storage,
            Purpose::Kitchen,
            Purpose::Bathroom,
        ][r.weighted(&[7.0, 1.5, 1.0, 0.8, 0.7, 0.8])];
        let width = match purpose {
            Purpose::Meeting => r.between(4.0, 6.0),
            Purpose::Storage | Purpose::Bathroom => r.between(2.4, 3.0),
            Purpose::Office if r.chance(0.2) => r.between(5.0, 7.0),
            _ => r.between(3.2, 4.4),
        };
        // The last room takes what is left.
        let end = if length - (x + width) < 2.3 {
            length
        } else {
            x + width
        };
        cells.push(Cell::new(Vec2::new(x, y0), Vec2::new(end, y1), purpose));
        x = end;
    }
}
