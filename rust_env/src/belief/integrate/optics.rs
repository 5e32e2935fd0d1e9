//! What depends on a camera's pixels alone, computed once and shared by all integrators of a process.
use super::ends::BLOCK;
use super::witnesses::Witnesses;
use crate::belief::uncertainty::UncertaintyModel;
use crate::camera::Camera;
use crate::geometry::Vec3;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError, Weak};

/// Lists in the order of rays, padded as those of [`super::ends::Ends`] are.
pub struct Optics {
    camera: Camera,
    pub model: UncertaintyModel,
    /// They say in which order.
    pub witnesses: Witnesses,
    /// Ray directions with z = 1, and their lengths.
    pub x: Vec<f32>,
    pub y: Vec<f32>,
    pub length: Vec<f32>,
    /// Lluvia 2023, Eq. 7.
    pub angle: Vec<f32>,
}

struct Shared {
    /// All that are in use.
    held: Vec<Weak<Optics>>,
    /// The last few, in use or not: maps are often made one after the other.
    recent: VecDeque<Arc<Optics>>,
}

const RECENT: usize = 2;

static SHARED: Mutex<Shared> = Mutex::new(Shared {
    held: Vec::new(),
    recent: VecDeque::new(),
});

impl Optics {
    /// Those of a camera; made if nobody holds them.
    pub fn of(camera: &Camera, model: &UncertaintyModel) -> Arc<Self> {
        let find = |all: &Shared| {
            let mut held = all.held.iter().filter_map(Weak::upgrade);
            held.find(|optics| optics.is_of(camera, model))
        };
        let lock = || SHARED.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(optics) = find(&lock()) {
            return optics;
        }
        // Not while others wait.
        let made = Arc::new(Self::new(camera, model));
        let mut all = lock();
        if let Some(optics) = find(&all) {
            return optics;
        }
        all.recent.truncate(RECENT - 1);
        all.recent.push_front(made.clone());
        all.held.retain(|optics| optics.strong_count() > 0);
        all.held.push(Arc::downgrade(&made));
        made
    }

    pub fn is_of(&self, camera: &Camera, model: &UncertaintyModel) -> bool {
        self.camera == *camera && self.model == *model
    }

    fn new(camera: &Camera, model: &UncertaintyModel) -> Self {
        let witnesses = Witnesses::new(camera);
        let order = || witnesses.order.iter().map(|pixel| *pixel as usize);
        let rays: Vec<Vec3> = order()
            .map(|pixel| camera.ray(pixel % camera.width, pixel / camera.width))
            .collect();
        let padded = rays.len().next_multiple_of(BLOCK);
        let list = |values: &mut dyn Iterator<Item = f32>| {
            let mut list: Vec<f32> = values.collect();
            list.resize(padded, 1.0);
            list
        };
        let angle = model.angle_table(camera);
        Self {
            x: list(&mut rays.iter().map(|r| r.x)),
            y: list(&mut rays.iter().map(|r| r.y)),
            length: list(&mut rays.iter().map(|r| r.length())),
            angle: list(&mut order().map(|pixel| angle[pixel])),
            camera: camera.clone(),
            model: *model,
            witnesses,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_cameras_share() {
        let camera = |width| Camera::from_fov(width, 7, 1.0, 0.7, 0.0, 5.0).unwrap();
        let model = UncertaintyModel::of_camera(&camera(9));
        let one = Optics::of(&camera(9), &model);
        assert!(Arc::ptr_eq(&one, &Optics::of(&camera(9), &model)));
        let other = Optics::of(&camera(11), &model);
        assert!(!Arc::ptr_eq(&one, &other) && other.is_of(&camera(11), &model));
    }
}
