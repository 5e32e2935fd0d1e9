//! Plans of several rooms: rectangular cells that share walls, doors between them, each furnished by its purpose.
use super::draft::{Draft, SLAB};
use super::draw::{Draw, Random};
use super::footprint::area;
use super::furnish::{furnish, Purpose};
use super::layout::Layout;
use super::room::FREE_RADIUS;
use super::solid;
use super::walkways::{open_ways, Doorway};
use super::walls::{fit_opening, hang_leaf, wall, Opening};
use glam::Vec2;

/// A rectangle of the plan between the middle lines of its walls.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cell {
    pub min: Vec2,
    pub max: Vec2,
    pub purpose: Purpose,
}

impl Cell {
    pub fn new(min: Vec2, max: Vec2, purpose: Purpose) -> Self {
        Self { min, max, purpose }
    }

    pub fn size(&self) -> Vec2 {
        self.max - self.min
    }

    pub fn area(&self) -> f32 {
        let size = self.size();
        size.x * size.y
    }

    fn corners(&self) -> [Vec2; 4] {
        let (a, b) = (self.min, self.max);
        [a, Vec2::new(b.x, a.y), b, Vec2::new(a.x, b.y)]
    }

    /// Halves along x or y at `share`.
    pub fn split(&self, along_x: bool, share: f32) -> [Cell; 2] {
        let cut = self.min + self.size() * share;
        let (mut low, mut high) = (*self, *self);
        if along_x {
            (low.max.x, high.min.x) = (cut.x, cut.x);
        } else {
            (low.max.y, high.min.y) = (cut.y, cut.y);
        }
        [low, high]
    }
}

/// A straight piece of wall with cell `left` on its left and `right` or the outside on its right.
#[derive(Clone, Debug)]
pub(super) struct Border {
    pub a: Vec2,
    pub b: Vec2,
    pub left: usize,
    pub right: Option<usize>,
    pub openings: Vec<Opening>,
}

impl Border {
    pub fn length(&self) -> f32 {
        self.a.distance(self.b)
    }

    /// Cuts the opening somewhere into the wall if there is room for it.
    pub fn cut(&mut self, opening: Opening, random: &mut Random) -> bool {
        let margin = opening.width / 2.0 + 0.3;
        for _ in 0..8 {
            let at = random.between(margin, self.length() - margin);
            let opening = Opening { at, ..opening };
            if self.length() > 2.0 * margin && opening.is_apart(&self.openings) {
                self.openings.push(opening);
                return true;
            }
        }
        false
    }
}

#[derive(Clone, Debug)]
pub(super) struct Plan {
    pub cells: Vec<Cell>,
    pub borders: Vec<Border>,
    /// Room height above the floor.
    pub height: f32,
    pub ceiling: bool,
    /// Thickness of walls between cells and to the outside.
    pub inner: f32,
    pub outer: f32,
}

impl Plan {
    pub fn new(cells: Vec<Cell>, random: &mut Random) -> Self {
        let borders = borders(&cells);
        Self {
            cells,
            borders,
            height: 2.4 + 0.9 * random.between(0.0, 1.0).powi(2),
            ceiling: random.chance(0.5),
            inner: random.between(0.1, 0.16),
            outer: random.between(0.18, 0.3),
        }
    }

    /// Doors along a random tree from cell 0, so that every cell can be reached; plus a few more (`extra` = chance).
    /// False if some cell shares no wall long enough for a door with the others.
    pub fn connect(&mut self, extra: f32, random: &mut Random) -> bool {
        let mut reached = vec![false; self.cells.len()];
        reached[0] = true;
        loop {
            let open: Vec<usize> = (0..self.borders.len())
                .filter(|i| {
                    let border = &self.borders[*i];
                    let Some(right) = border.right else {
                        return false;
                    };
                    reached[border.left] != reached[right] && border.length() > 1.75
                })
                .collect();
            if open.is_empty() {
                break;
            }
            // A hall opens most doors, as halls do.
            let weights: Vec<f32> = open
                .iter()
                .map(|i| {
                    if self.touches(*i, Purpose::Hall) {
                        8.0
                    } else {
                        1.0
                    }
                })
                .collect();
            let i = open[random.weighted(&weights)];
            self.join(i, random);
            let border = &self.borders[i];
            reached[border.left] = true;
            reached[border.right.unwrap_or(0)] = true;
        }
        for i in 0..self.borders.len() {
            let border = &self.borders[i];
            if border.right.is_some() && border.openings.is_empty() && border.length() > 1.75 {
                let corridors = self.touches(i, Purpose::Hall);
                if random.chance(if corridors { extra * 0.5 } else { extra }) {
                    self.join(i, random);
                }
            }
        }
        reached.into_iter().all(|r| r)
    }

    fn touches(&self, border: usize, purpose: Purpose) -> bool {
        let border = &self.borders[border];
        let is = |i: usize| self.cells[i].purpose == purpose;
        is(border.left) || border.right.is_some_and(is)
    }

    /// A door, or between kitchen, dining and living room mostly an open passage
    /// (ProcTHOR: 0.75, half of them without any wall), and between two halls always one.
    fn join(&mut self, i: usize, random: &mut Random) {
        let border = &self.borders[i];
        let length = border.length();
        let purposes = [border.left, border.right.unwrap_or(border.left)];
        let day = |i: usize| {
            use Purpose::{Dining, Kitchen, Living};
            matches!(self.cells[i].purpose, Kitchen | Living | Dining)
        };
        let is_open = purposes.iter().all(|p| day(*p)) && random.chance(0.75);
        let are_halls = purposes
            .iter()
            .all(|p| self.cells[*p].purpose == Purpose::Hall);
        let opening = if is_open || are_halls {
            let width = if are_halls || random.chance(0.5) {
                length - 0.65
            } else {
                random.between(0.9, 2.0).min(length - 0.65)
            };
            let top = random.between(2.05, self.height - 0.1);
            Opening::passage(0.0, width, top)
        } else {
            Opening::inner_door(0.0, random)
        };
        self.borders[i].cut(opening, random);
    }

    /// A door to the outside from one of the cells for which `may` holds.
    pub fn enter(&mut self, may: impl Fn(&Cell) -> bool, random: &mut Random) {
        let outside: Vec<usize> = (0..self.borders.len())
            .filter(|i| {
                let b = &self.borders[*i];
                b.right.is_none() && may(&self.cells[b.left]) && b.length() > 1.7
            })
            .collect();
        if !outside.is_empty() {
            let door = Opening::door(0.0, random);
            let i = random.one_of(&outside);
            self.borders[i].cut(door, random);
        }
    }

    /// A gate for lorries in the outer wall of cell 0.
    pub fn gate(&mut self, random: &mut Random) {
        let walls: Vec<usize> = (0..self.borders.len())
            .filter(|i| self.borders[*i].left == 0 && self.borders[*i].right.is_none())
            .collect();
        if !walls.is_empty() {
            let gate = Opening::passage(0.0, random.between(2.4, 3.2), random.between(2.8, 3.6));
            let i = random.one_of(&walls);
            self.borders[i].cut(gate, random);
        }
    }

    /// Windows in the outer walls, about one each `spacing` metres.
    pub fn windows(&mut self, spacing: f32, random: &mut Random) {
        for border in &mut self.borders {
            if border.right.is_some() {
                continue;
            }
            let wanted = border.length() / spacing * random.between(0.4, 1.4);
            let is_wet = self.cells[border.left].purpose == Purpose::Bathroom;
            for _ in 0..wanted.round() as usize {
                let width = if is_wet {
                    random.between(0.5, 0.8)
                } else {
                    random.between(0.9, 1.75)
                };
                let window = Opening::window(0.0, width, random);
                border.cut(window, random);
            }
        }
    }

    /// Walls, floor and furniture. The first start is in a cell that holds its free disc.
    pub fn build(
        &self,
        random: &mut Random,
        mut furnish_cell: impl FnMut(&mut Layout, Purpose, f32, &mut Random),
    ) -> Draft {
        let floor = random.between(0.01, 0.05);
        let mut draft = Draft {
            floor,
            ..Draft::default()
        };
        let mut rooms: Vec<Layout> = (0..self.cells.len())
            .map(|i| {
                let mut layout = Layout::new(self.inside(i), floor, self.height);
                layout.ceiling = self.ceiling;
                layout
            })
            .collect();
        let mut leaves = Vec::new();
        for border in &self.borders {
            self.raise(border, &mut draft, &mut rooms, &mut leaves, random);
        }
        for (room, line, opening) in &leaves {
            hang_leaf(&mut rooms[*room], *line, opening, random);
        }
        for cell in &self.cells {
            let edge = Vec2::splat(self.outer / 2.0);
            let outline = Cell::new(cell.min - edge, cell.max + edge, cell.purpose).corners();
            // Slabs of neighbours overlap by a wall's thickness below the walls only.
            solid::prism(&mut draft.shell, &outline, floor - SLAB, floor);
            if self.ceiling {
                let top = floor + self.height;
                solid::prism(&mut draft.shell, &outline, top, top + SLAB);
            }
        }
        let home = self.start_cell(random);
        for (i, room) in rooms.iter_mut().enumerate() {
            let free = if i == home { FREE_RADIUS } else { 0.5 };
            furnish_cell(room, self.cells[i].purpose, free, random);
        }
        rooms.swap(0, home);
        draft.rooms = rooms;
        draft.find_starts(random);
        draft
    }

    /// One of the cells wide enough for the free disc; the widest if none is.
    fn start_cell(&self, random: &mut Random) -> usize {
        let width = |i: usize| self.cells[i].size().min_element();
        let wide: Vec<usize> = (0..self.cells.len())
            .filter(|i| width(*i) > 3.3 && self.cells[*i].area() > 12.0)
            .collect();
        if wide.is_empty() {
            (0..self.cells.len())
                .max_by(|a, b| width(*a).total_cmp(&width(*b)))
                .unwrap_or(0)
        } else {
            let weights: Vec<f32> = wide.iter().map(|i| self.cells[*i].area()).collect();
            wide[random.weighted(&weights)]
        }
    }

    fn thickness(&self, border: &Border) -> f32 {
        if border.right.is_some() {
            self.inner
        } else {
            self.outer
        }
    }

    /// The cell without its halves of the walls.
    fn inside(&self, cell: usize) -> Vec<Vec2> {
        let mut c = self.cells[cell];
        let (min, max) = (c.min, c.max);
        for border in &self.borders {
            if border.left != cell && border.right != Some(cell) {
                continue;
            }
            let half = self.thickness(border) / 2.0;
            let p = (border.a + border.b) / 2.0;
            if (p.x - min.x).abs() < 1e-3 {
                c.min.x = c.min.x.max(min.x + half);
            } else if (p.x - max.x).abs() < 1e-3 {
                c.max.x = c.max.x.min(max.x - half);
            } else if (p.y - min.y).abs() < 1e-3 {
                c.min.y = c.min.y.max(min.y + half);
            } else {
                c.max.y = c.max.y.min(max.y - half);
            }
        }
        c.corners().to_vec()
    }

    /// Builds a wall; its doors' leaves are hung later.
    fn raise(
        &self,
        border: &Border,
        draft: &mut Draft,
        rooms: &mut [Layout],
        leaves: &mut Vec<(usize, [Vec2; 2], Opening)>,
        random: &mut Random,
    ) {
        let half = self.thickness(border) / 2.0;
        let along = (border.b - border.a).normalize_or(Vec2::X);
        let side = along.perp() * half;
        // Walls reach half their thickness beyond their ends: corners close.
        let (a, b) = (border.a - along * half, border.b + along * half);
        let shifted: Vec<Opening> = border
            .openings
            .iter()
            .map(|o| Opening {
                at: o.at + half,
                ..*o
            })
            .collect();
        let (inner, outer) = ([a + side, b + side], [a - side, b - side]);
        wall(
            &mut draft.shell,
            inner,
            outer,
            draft.floor,
            self.height,
            &shifted,
        );
        for opening in &border.openings {
            let left_hung = border.right.is_none() || random.chance(0.5);
            let line = [border.a + side, border.b + side];
            fit_opening(&mut rooms[border.left], line, opening, random);
            let Some(right) = border.right else {
                leaves.push((border.left, line, *opening));
                continue;
            };
            for (room, inward) in [(border.left, side), (right, -side)] {
                rooms[room].doorways.push(Doorway {
                    at: border.a + along * opening.at + inward,
                    inward: inward.normalize_or_zero(),
                    width: opening.width,
                });
            }
            let back = [border.b - side, border.a - side];
            let mirrored = Opening {
                at: border.length() - opening.at,
                ..*opening
            };
            fit_opening(&mut rooms[right], back, &mirrored, random);
            leaves.push(match left_hung {
                true => (border.left, line, *opening),
                false => (right, back, mirrored),
            });
        }
    }
}

/// All walls of a set of cells that do not overlap, in an order that depends on the cells' order only.
fn borders(cells: &[Cell]) -> Vec<Border> {
    const SAME: f32 = 1e-3;
    let mut all = Vec::new();
    for (i, cell) in cells.iter().enumerate() {
        let corners = cell.corners();
        for k in 0..4 {
            let (a, b) = (corners[k], corners[(k + 1) % 4]);
            let along = (b - a).normalize_or(Vec2::X);
            let length = a.distance(b);
            let mut shared: Vec<(f32, f32, usize)> = Vec::new();
            for (j, other) in cells.iter().enumerate() {
                let opposite = other.corners();
                let (c, d) = (opposite[(k + 2) % 4], opposite[(k + 3) % 4]);
                if i != j && (c - a).perp_dot(along).abs() < SAME {
                    let from = (d - a).dot(along).max(0.0);
                    let to = (c - a).dot(along).min(length);
                    if to - from > SAME {
                        shared.push((from, to, j));
                    }
                }
            }
            shared.sort_by(|x, y| x.0.total_cmp(&y.0));
            let mut push = |from: f32, to: f32, right: Option<usize>| {
                if to - from > SAME {
                    all.push(Border {
                        a: a + along * from,
                        b: a + along * to,
                        left: i,
                        right,
                        openings: Vec::new(),
                    });
                }
            };
            let mut done = 0.0;
            for (from, to, j) in shared {
                push(done, from, None);
                // The neighbour of lower number has built the common wall.
                if j > i {
                    push(from, to, Some(j));
                }
                done = to;
            }
            push(done, length, None);
        }
    }
    all
}

/// The usual way to furnish a cell.
pub(super) fn by_purpose(layout: &mut Layout, purpose: Purpose, free: f32, random: &mut Random) {
    if area(&layout.outline) > 1.0 {
        furnish(layout, purpose, free, random);
    }
}

/// The same, and nothing stands in anybody's way.
pub(super) fn with_ways(layout: &mut Layout, purpose: Purpose, free: f32, random: &mut Random) {
    by_purpose(layout, purpose, free, random);
    open_ways(layout);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbours_share_one_wall() {
        let cell = |a: [f32; 2], b: [f32; 2]| Cell::new(a.into(), b.into(), Purpose::Living);
        // Two cells side by side under a long one.
        let cells = [
            cell([0.0, 0.0], [3.0, 3.0]),
            cell([3.0, 0.0], [7.0, 3.0]),
            cell([0.0, 3.0], [7.0, 5.0]),
        ];
        let all = borders(&cells);
        let shared: Vec<_> = all
            .iter()
            .filter_map(|b| Some((b.left, b.right?, b.length())))
            .collect();
        assert_eq!(shared, [(0, 1, 3.0), (0, 2, 3.0), (1, 2, 4.0)]);
        let outside: f32 = all
            .iter()
            .filter(|b| b.right.is_none())
            .map(Border::length)
            .sum();
        assert!((outside - 24.0).abs() < 1e-4);
    }
}
