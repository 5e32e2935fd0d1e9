use super::*;
use crate::belief::testing::{empty, observe, RESOLUTION};
use crate::geometry::IVec3;

const SHOULDER: Vec3 = Vec3::new(0.04, 0.02, 1.25);

struct Fixture {
    octree: Octree,
    arm: Arm,
    space: ViewSpace,
    views: Vec<Pose>,
}

impl Fixture {
    /// A map that holds these voxels as occupied.
    fn new(occupied: impl IntoIterator<Item = IVec3>) -> Self {
        let mut octree = empty();
        observe(&mut octree, occupied, true, 0.5);
        let space = ViewSpace::dome(14, 48, 0.6, -35f64.to_radians(), 60f64.to_radians()).unwrap();
        Self {
            octree,
            arm: Arm::new(0.425, 0.392, 0.06).unwrap(),
            views: space.views(&Pose::IDENTITY, SHOULDER),
            space,
        }
    }

    fn plan(&self) -> ArmPlan<'_> {
        ArmPlan {
            octree: &self.octree,
            arm: &self.arm,
            shoulder: SHOULDER,
            ball: 0.1,
            space: &self.space,
            views: &self.views,
        }
    }

    fn hand(&self, ring: usize, i: usize) -> Vec3 {
        self.views[ring * 48 + i].translation
    }

    fn clear(&self) -> usize {
        let plan = self.plan();
        self.views
            .iter()
            .filter(|v| plan.is_clear_at(v.translation))
            .count()
    }
}

/// The voxels of a wall across the elbow's way, at a quarter turn: above the line from shoulder to hand.
fn wall(top: f32) -> Vec<IVec3> {
    let mut keys = Vec::new();
    for (y, z) in (2..5).flat_map(|y| (14..(top * 10.0) as i32).map(move |z| (y, z))) {
        keys.push(IVec3::new(0, y, z));
    }
    keys
}

#[test]
fn an_empty_map_forbids_nothing() {
    let fixture = Fixture::new([IVec3::new(12, 0, 12), IVec3::new(0, 0, 0)]);
    let plan = fixture.plan();
    assert_eq!(fixture.clear(), 672);
    let (from, to) = (fixture.hand(5, 0), fixture.hand(9, 20));
    assert_eq!(plan.plan(from, to), Some(vec![from, to]));
    let costs = plan.travel_costs(
        from,
        &[from, fixture.hand(5, 1), to, SHOULDER + Vec3::X * 2.0],
    );
    let step = from.distance(fixture.hand(5, 1));
    assert!(
        costs[0] == 0.0 && (costs[1] - step).abs() < 1e-6,
        "{costs:?}"
    );
    // On a sphere of this radius the hand goes farther than as the crow flies.
    assert!(costs[2] > from.distance(to) && costs[2] < 0.6 * std::f32::consts::PI * 1.2);
    assert_eq!(costs[3], f32::INFINITY);
}

#[test]
fn a_voxel_in_the_forearm_forbids_what_it_would_not_forbid_a_ball() {
    let fixture = Fixture::new(wall(1.8));
    let plan = fixture.plan();
    let behind = fixture.hand(5, 12);
    assert!(sphere_is_clear(&fixture.octree, behind, 0.1, true));
    assert!(!plan.is_clear_at(behind) && plan.is_clear_at(fixture.hand(5, 36)));
    // By brute force: the centres of occupied voxels against points of the links.
    let clear = fixture.clear();
    assert!((300..650).contains(&clear), "{clear}");
    for view in &fixture.views {
        let posture = plan.arm.posture(SHOULDER, view.translation);
        let inside = plan.arm.links(SHOULDER, &posture).iter().any(|link| {
            (0..=50)
                .map(|i| link.a.lerp(link.b, i as f32 / 50.0))
                .any(|p| {
                    wall(1.8).iter().any(|k| {
                        let low = k.as_vec3() * RESOLUTION as f32;
                        p.clamp(low, low + RESOLUTION as f32).distance(p) < link.radius - 1e-3
                    })
                })
        });
        assert!(!inside || !plan.is_clear_at(view.translation), "{view:?}");
    }
}

#[test]
fn ways_lead_around() {
    let fixture = Fixture::new(wall(1.8));
    let plan = fixture.plan();
    let (from, to) = (fixture.hand(5, 2), fixture.hand(5, 22));
    assert!(!plan.swing_is_clear(from, to));
    let path = plan.plan(from, to).unwrap();
    assert!(
        path.len() > 2 && path[0] == from && path[path.len() - 1] == to,
        "{path:?}"
    );
    for leg in path.windows(2) {
        assert!(plan.swing_is_clear(leg[0], leg[1]), "{leg:?}");
    }
    let length: f32 = path.windows(2).map(|w| w[0].distance(w[1])).sum();
    let cost = plan.travel_costs(from, &[to])[0];
    assert!(cost.is_finite() && length <= cost + 1e-3, "{length} {cost}");
    // Where the arm cannot be held there is no way.
    let behind = fixture.hand(5, 12);
    assert_eq!(plan.plan(from, behind), None);
    assert_eq!(plan.travel_costs(from, &[behind]), [f32::INFINITY]);
}
