//! Many episodes at once, and two verbs: `reset` and `step`.
use crate::belief::gain::{Gain, RaySpacing};
use crate::belief::octree::Change;
use crate::episode::{Episode, STAGES};
use crate::error::{Error, Result};
use crate::fault;
use crate::geometry::Pose;
use crate::interrupt::{self, Stop};
use crate::metrics::METRICS;
use crate::setup::Setup;
use crate::snapshot::{self, SlotState};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;
use std::sync::Arc;
use std::time::Instant;

/// Where the observations of all environments go; row `i` belongs to environment `i`. What is `None` is not computed.
#[derive(Default)]
pub struct Buffers<'a> {
    /// (n, height, width) metres.
    pub depth: Option<&'a mut [f32]>,
    /// (n, rays) metres.
    pub scan: Option<&'a mut [f32]>,
    /// (n, 7) the believed viewpoint.
    pub pose: Option<&'a mut [f32]>,
    /// (n, 3, size, size, size).
    pub local_map: Option<&'a mut [f32]>,
    /// (n, candidates) how often each was visited.
    pub visited: Option<&'a mut [f32]>,
    /// (n, candidates, 7).
    pub candidates: Option<&'a mut [f32]>,
    /// (n, candidates) admissible by belief.
    pub mask: Option<&'a mut [bool]>,
    /// (n, METRICS).
    pub metrics: Option<&'a mut [f64]>,
}

/// One environment's rows of the buffers.
#[derive(Default)]
struct Rows<'a> {
    depth: Option<&'a mut [f32]>,
    scan: Option<&'a mut [f32]>,
    pose: Option<&'a mut [f32]>,
    local_map: Option<&'a mut [f32]>,
    visited: Option<&'a mut [f32]>,
    candidates: Option<&'a mut [f32]>,
    mask: Option<&'a mut [bool]>,
    metrics: Option<&'a mut [f64]>,
}

impl Rows<'_> {
    fn fill(&mut self, episode: &Episode) {
        let belief = episode.belief();
        if let Some(depth) = &mut self.depth {
            depth.copy_from_slice(episode.image());
        }
        if let Some(scan) = &mut self.scan {
            scan.copy_from_slice(episode.scan());
        }
        if let Some(pose) = &mut self.pose {
            pose.copy_from_slice(&belief.pose().to_array());
        }
        if let (Some(out), Some(window)) = (&mut self.local_map, &episode.setup().local_map) {
            belief.local_map(window, out);
        }
        if let Some(visited) = &mut self.visited {
            for (out, count) in visited.iter_mut().zip(belief.visited()) {
                *out = f32::from(*count);
            }
        }
        if let Some(candidates) = &mut self.candidates {
            for (out, view) in candidates.chunks_exact_mut(7).zip(belief.candidates()) {
                out.copy_from_slice(&view.to_array());
            }
        }
        if let Some(mask) = &mut self.mask {
            belief.mask(mask);
        }
        if let Some(metrics) = &mut self.metrics {
            episode.metrics().write(metrics);
        }
    }
}

/// One environment: its running episode and, between episodes, where the next seed comes from.
struct Slot {
    episode: Option<Episode>,
    /// Gives the seeds of the episodes after the first.
    seeds: Pcg64Mcg,
    /// Set by a panic or an interrupt: the episode may be half changed, so that it must not go on.
    poisoned: bool,
    /// Panic at the next call: how tests see what a fault of our own does.
    faulty: bool,
    /// Seconds of finished episodes per stage, and of filling observations.
    seconds: [f64; 6],
}

/// A thread pool of our own, made when it is first needed and again in a forked child, whose parent's threads are gone.
struct Pool {
    threads: usize,
    made: Option<(u32, Arc<rayon::ThreadPool>)>,
}

impl Pool {
    fn get(&mut self) -> Result<Option<Arc<rayon::ThreadPool>>> {
        if self.threads <= 1 {
            return Ok(None);
        }
        let process = std::process::id();
        match &self.made {
            Some((owner, pool)) if *owner == process => return Ok(Some(pool.clone())),
            // Dropping the parent's pool here would wait for threads that do not exist.
            Some(_) => std::mem::forget(self.made.take()),
            None => {}
        }
        let pool = own_pool(self.threads)?.map(Arc::new);
        self.made = pool.clone().map(|p| (process, p));
        Ok(pool)
    }
}

/// Threads of our own (rayon's global pool would hang in a forked child); none at all for one thread.
pub fn own_pool(threads: usize) -> Result<Option<rayon::ThreadPool>> {
    if threads == 0 || threads > MAX_THREADS {
        return Err(Error::invalid(format!(
            "num_threads must be 1..={MAX_THREADS}, got {threads}"
        )));
    }
    if threads == 1 {
        return Ok(None);
    }
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .thread_name(|i| format!("nbv-gym-{i}"))
        .start_handler(|_| fault::panics_are_passed_on());
    pool.build()
        .map(Some)
        .map_err(|e| Error::invalid(format!("num_threads = {threads}: {e}")))
}

pub struct Simulator {
    setup: Arc<Setup>,
    slots: Vec<Slot>,
    pool: Pool,
}

/// Largest number of environments in one simulator, and of threads.
pub const MAX_ENVS: usize = 1 << 16;
pub const MAX_THREADS: usize = 1024;

impl Simulator {
    pub fn new(setup: Setup, num_envs: usize, num_threads: usize) -> Result<Self> {
        if num_envs == 0 || num_envs > MAX_ENVS {
            return Err(Error::invalid(format!(
                "num_envs must be 1..={MAX_ENVS}, got {num_envs}"
            )));
        }
        if num_threads == 0 || num_threads > MAX_THREADS {
            own_pool(num_threads)?;
        }
        let slots = (0..num_envs)
            .map(|i| Slot {
                episode: None,
                seeds: Pcg64Mcg::seed_from_u64(i as u64),
                poisoned: false,
                faulty: false,
                seconds: [0.0; 6],
            })
            .collect();
        Ok(Self {
            setup: Arc::new(setup),
            slots,
            pool: Pool {
                threads: num_threads,
                made: None,
            },
        })
    }

    pub fn num_envs(&self) -> usize {
        self.slots.len()
    }
    pub fn setup(&self) -> &Setup {
        &self.setup
    }
    pub fn num_candidates(&self) -> usize {
        self.setup.views.count()
    }

    /// All environments as they are now, so that [`Simulator::load`] goes on bit for bit. `notes` are the caller's own.
    pub fn save(&self, notes: &[u8]) -> Result<Vec<u8>> {
        let mut slots = Vec::with_capacity(self.slots.len());
        for (i, slot) in self.slots.iter().enumerate() {
            if slot.poisoned {
                return Err(Error::Internal(format!("environment {i} failed; reset it")));
            }
            slots.push(SlotState {
                seeds: slot.seeds.clone(),
                episode: slot.episode.as_ref().map(Episode::save).transpose()?,
            });
        }
        snapshot::write(&self.setup, notes, slots)
    }

    /// Go on where a simulator of the same setup and number of environments was saved, and fill the rows of environments
    /// with an episode. Nothing changes on an error; the bytes may come from anywhere.
    pub fn load(&mut self, bytes: &[u8], buffers: Buffers) -> Result<()> {
        let snapshot = snapshot::read(bytes)?;
        snapshot.check_setup(&self.setup)?;
        self.check_length("the snapshot", snapshot.slots.len())?;
        let rows = buffers.rows(self.slots.len())?;
        let load = |state: &SlotState| -> Result<Slot> {
            let episode = state.episode.as_ref();
            let episode = episode.map(|e| Episode::load(self.setup.clone(), e));
            Ok(Slot {
                episode: episode.transpose()?,
                seeds: state.seeds.clone(),
                poisoned: false,
                faulty: false,
                seconds: [0.0; 6],
            })
        };
        self.slots = snapshot.slots.iter().map(load).collect::<Result<_>>()?;
        for (slot, mut rows) in self.slots.iter().zip(rows) {
            if let Some(episode) = &slot.episode {
                rows.fill(episode);
            }
        }
        Ok(())
    }

    /// The voxels of environment `i`'s map whose state changed since the last call, or since its episode began.
    pub fn changed(&mut self, i: usize) -> Result<Vec<Change>> {
        self.episode(i)?;
        let episode = self.slots.get_mut(i).and_then(|s| s.episode.as_mut());
        Ok(episode.map(Episode::changed).unwrap_or_default())
    }

    /// The running episode of environment `i`.
    pub fn episode(&self, i: usize) -> Result<&Episode> {
        let slot = self.slots.get(i).ok_or_else(|| {
            Error::invalid(format!(
                "environment {i} does not exist, there are {}",
                self.slots.len()
            ))
        })?;
        match (&slot.episode, slot.poisoned) {
            (_, true) => Err(Error::Internal(format!(
                "environment {i} failed or was interrupted; reset it"
            ))),
            (None, _) => Err(Error::invalid(format!(
                "environment {i} has no episode yet; call reset first"
            ))),
            (Some(episode), _) => Ok(episode),
        }
    }

    /// Begin new episodes where `mask` is set; other rows of the buffers stay as they are.
    /// `seeds[i]` begins environment `i`'s stream of seeds anew, `None` goes on with it.
    pub fn reset(&mut self, mask: &[bool], seeds: &[Option<u64>], buffers: Buffers) -> Result<()> {
        self.check_length("mask", mask.len())?;
        self.check_length("seeds", seeds.len())?;
        self.run(mask, buffers, |i, slot, setup| slot.reset(setup, seeds[i]))
    }

    /// Step every environment to its viewpoint; those with `reset_mask` set begin a new episode instead.
    /// All viewpoints are checked before anything changes.
    pub fn step(
        &mut self,
        commands: &[[f32; 7]],
        reset_mask: &[bool],
        buffers: Buffers,
    ) -> Result<()> {
        self.check_length("commands", commands.len())?;
        self.check_length("reset_mask", reset_mask.len())?;
        let mut goals = Vec::with_capacity(commands.len());
        for (i, command) in commands.iter().enumerate() {
            if reset_mask[i] {
                goals.push(Pose::IDENTITY);
            } else {
                self.episode(i)?;
                let goal = Pose::from_array(*command);
                goals.push(goal.map_err(|e| Error::invalid(format!("environment {i}: {e}")))?);
            }
        }
        self.run(&vec![true; commands.len()], buffers, |i, slot, setup| {
            if reset_mask[i] {
                return slot.reset(setup, None);
            }
            match &mut slot.episode {
                Some(episode) => episode.step(&goals[i]),
                None => Ok(()),
            }
        })
    }

    /// The metrics that a step to each viewpoint would give in environment `i`. For oracles only.
    pub fn foresee(&mut self, i: usize, goals: &[Pose]) -> Result<Vec<[f64; METRICS.len()]>> {
        let pool = self.pool.get()?;
        let episode = self.episode(i)?;
        let stop = Stop::of_this_thread();
        let one = |goal: &Pose| {
            interrupt::check()?;
            stop.check()?;
            let mut row = [0.0; METRICS.len()];
            episode.foresee(goal).map(|m| m.write(&mut row))?;
            Ok(row)
        };
        match pool {
            Some(pool) => interrupt::in_pool(&pool, || goals.par_iter().map(one).collect())
                .unwrap_or(Err(Error::Interrupted)),
            None => goals.iter().map(one).collect(),
        }
    }

    /// Whether contact would stop the robot on its way to each viewpoint in environment `i`. For oracles only.
    pub fn foresee_contact(&self, i: usize, goals: &[Pose]) -> Result<Vec<bool>> {
        let episode = self.episode(i)?;
        let one = |goal: &Pose| {
            interrupt::check()?;
            Ok(episode.foresee_contact(goal))
        };
        goals.iter().map(one).collect()
    }

    /// The gains of viewpoints in environment `i`, by its belief.
    pub fn view_gain(
        &mut self,
        i: usize,
        views: &[Pose],
        gain: Gain,
        rays: RaySpacing,
    ) -> Result<Vec<f64>> {
        let pool = self.pool.get()?;
        let belief = self.episode(i)?.belief();
        belief.view_gain(views, gain, rays, pool.as_deref())
    }

    /// Environment `i` panics at its next step or reset. For tests.
    pub fn fail_next(&mut self, i: usize) -> Result<()> {
        self.episode(i)?;
        self.slots[i].faulty = true;
        Ok(())
    }

    /// Wall-clock seconds per stage of a step, all environments together.
    pub fn timings(&self) -> Vec<(&'static str, f64)> {
        let mut total = [0.0; STAGES.len()];
        for slot in &self.slots {
            let running = slot
                .episode
                .as_ref()
                .map_or([0.0; STAGES.len()], |e| e.seconds);
            for (sum, (a, b)) in total.iter_mut().zip(slot.seconds.iter().zip(running)) {
                *sum += a + b;
            }
        }
        STAGES.into_iter().zip(total).collect()
    }

    fn check_length(&self, name: &str, length: usize) -> Result<()> {
        if length == self.slots.len() {
            return Ok(());
        }
        Err(Error::invalid(format!(
            "{name} has {length} rows for {} environments",
            self.slots.len()
        )))
    }

    /// Work on the active environments, each on one thread, and fill their rows. A panic poisons its environment and
    /// leaves the others unharmed; of several failures the first environment's is reported.
    fn run(
        &mut self,
        active: &[bool],
        buffers: Buffers,
        work: impl Fn(usize, &mut Slot, &Arc<Setup>) -> Result<()> + Sync,
    ) -> Result<()> {
        let pool = self.pool.get()?;
        let rows = buffers.rows(self.slots.len())?;
        let (setup, stop) = (&self.setup, Stop::of_this_thread());
        let one = |i: usize, slot: &mut Slot, mut rows: Rows| -> Result<()> {
            if !active[i] {
                return Ok(());
            }
            let outcome = fault::caught(|| {
                interrupt::check()?;
                stop.check()?;
                if std::mem::take(&mut slot.faulty) {
                    panic!("a fault that a test put here");
                }
                work(i, slot, setup)?;
                let started = Instant::now();
                if let Some(episode) = &mut slot.episode {
                    rows.fill(episode);
                    episode.seconds[STAGES.len() - 1] += started.elapsed().as_secs_f64();
                }
                Ok(())
            });
            let outcome = outcome
                .unwrap_or_else(|what| Err(Error::Internal(format!("environment {i}: {what}"))));
            // What was interrupted did not do its step, unlike the others.
            slot.poisoned |= matches!(outcome, Err(Error::Internal(_) | Error::Interrupted));
            outcome
        };
        let results: Vec<Result<()>> = match pool {
            Some(pool) => {
                let slots = self.slots.par_iter_mut().enumerate();
                let work = slots.zip(rows).map(|((i, slot), rows)| one(i, slot, rows));
                interrupt::in_pool(&pool, || work.collect()).unwrap_or_default()
            }
            None => {
                let slots = self.slots.iter_mut().enumerate();
                slots
                    .zip(rows)
                    .map(|((i, slot), rows)| one(i, slot, rows))
                    .collect()
            }
        };
        results.into_iter().collect()
    }
}

impl Slot {
    fn reset(&mut self, setup: &Arc<Setup>, seed: Option<u64>) -> Result<()> {
        if let Some(seed) = seed {
            self.seeds = Pcg64Mcg::seed_from_u64(seed);
        }
        let before = self.episode.take().map(|old| {
            for (sum, s) in self.seconds.iter_mut().zip(old.seconds) {
                *sum += s;
            }
            old.into_belief()
        });
        let seed = self.seeds.next_u64();
        self.episode = Some(Episode::after(before, setup.clone(), seed)?);
        self.poisoned = false;
        Ok(())
    }
}

impl<'a> Buffers<'a> {
    /// One row of each buffer per environment.
    fn rows(self, n: usize) -> Result<Vec<Rows<'a>>> {
        let mut rows: Vec<Rows<'a>> = (0..n).map(|_| Rows::default()).collect();
        macro_rules! share {
            ($($field:ident),*) => {$(
                if let Some(buffer) = self.$field {
                    let length = buffer.len() / n;
                    if length == 0 || buffer.len() % n != 0 {
                        return Err(Error::invalid(format!(
                            "buffer {} of {} values does not split over {n} environments",
                            stringify!($field), buffer.len()
                        )));
                    }
                    for (row, part) in rows.iter_mut().zip(buffer.chunks_exact_mut(length)) {
                        row.$field = Some(part);
                    }
                }
            )*};
        }
        share!(depth, scan, pose, local_map, visited, candidates, mask, metrics);
        Ok(rows)
    }
}
