//! Only what bars the way goes, and all that stands on it.
use super::*;
use crate::world::scenes::draw::Random;
use crate::world::scenes::layout::{Piece, Use};
use rand::SeedableRng;

fn cupboard(size: [f32; 3]) -> Piece {
    let mut piece = Piece::new(size[0], size[1], size[2]);
    piece.cuboid(
        [-size[0] / 2.0, -size[1] / 2.0, 0.0],
        [size[0] / 2.0, size[1] / 2.0, size[2]],
    );
    piece
}

/// A room of 4 x 2 m with doors at both ends, and pieces with their middle on its long axis.
fn room(pieces: &[(f32, [f32; 3])]) -> Layout {
    let random = &mut Random::seed_from_u64(1);
    let corners = [[0.0, 0.0], [4.0, 0.0], [4.0, 2.0], [0.0, 2.0]];
    let mut layout = Layout::new(corners.map(Vec2::from).to_vec(), 0.0, 2.5);
    layout.doorways = [(0.0, Vec2::X), (4.0, Vec2::NEG_X)]
        .map(|(x, inward)| Doorway {
            at: Vec2::new(x, 1.0),
            inward,
            width: 0.8,
        })
        .to_vec();
    for (x, size) in pieces {
        let mut piece = cupboard(*size);
        piece.top(0.0, size[2], Use::Dining);
        layout
            .put(&piece, Vec2::new(*x, 1.0), 0.0, 0.0, random)
            .unwrap();
    }
    layout
}

#[test]
fn what_bars_the_way_goes_with_all_that_stands_on_it() {
    // The first bars the way from wall to wall, one can get round the second.
    let bar = [0.4, 1.96, 0.8];
    let mut layout = room(&[(1.2, bar), (2.8, [0.4, 0.4, 0.8])]);
    let on_bar = layout.pieces.iter().filter(|k| k.root == 0).count();
    assert!(on_bar > 1 && layout.pieces.len() > on_bar, "{on_bar}");
    open_ways(&mut layout);
    let only = room(&[(2.8, [0.4, 0.4, 0.8])]);
    assert_eq!(layout.solid[0], only.solid[0]);
    assert!(layout.pieces.iter().all(|k| k.root == 0));
    assert_eq!(layout.mesh.vertices[..8], only.mesh.vertices[..8]);
    // Numbers without gaps, and each names triangles.
    let mut numbers = layout.objects.clone();
    numbers.dedup();
    let all: Vec<u32> = (1..=layout.instances as u32).collect();
    assert_eq!(numbers, all);
    assert_eq!(layout.pieces.len(), layout.instances);
    assert_eq!(layout.objects.len(), layout.mesh.triangles.len());
    let used = layout.mesh.triangles.as_flattened().iter().max();
    assert_eq!(used.copied(), Some(layout.mesh.vertices.len() as u32 - 1));
    let before = layout.mesh.clone();
    open_ways(&mut layout);
    assert_eq!(layout.mesh, before, "the ways are open");
}

#[test]
fn the_smaller_piece_goes() {
    // Side by side they bar the way.
    let random = &mut Random::seed_from_u64(1);
    let mut layout = room(&[]);
    for (y, depth) in [(0.65, 1.2), (1.6, 0.6)] {
        let piece = cupboard([0.8, depth, 1.0]);
        layout
            .put(&piece, Vec2::new(2.0, y), 0.0, 0.0, random)
            .unwrap();
    }
    open_ways(&mut layout);
    assert_eq!(layout.solid.len(), 1);
    assert_eq!(layout.solid[0].footprint.center.y, 0.65);
}

#[test]
fn what_is_stepped_over_or_passed_under_stays() {
    let mut layout = room(&[(1.2, [0.4, 1.96, 0.25])]);
    let lamp = cupboard([0.4, 1.96, 0.3]);
    let random = &mut Random::seed_from_u64(1);
    let above = layout.put(&lamp, Vec2::new(2.8, 1.0), 0.0, 1.9, random);
    assert!(above.is_some());
    let before = layout.mesh.clone();
    // The things on the low one are too small to matter, or too high.
    layout.solid.retain(|b| b.z[1] <= 0.26 || b.z[0] > 1.8);
    layout.pieces.retain(|k| k.first == 0);
    open_ways(&mut layout);
    assert_eq!(layout.mesh, before);
}
