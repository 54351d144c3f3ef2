//! The network over pictures or their parts, those of a size together.

use crate::detector::engines::{Engines, Kind};
use crate::detector::input::{Answer, Input};
use crate::detector::regions::{self, Window};
use crate::detector::runner::Given;
use crate::detector::{Config, Detections, Scene, contact};
use crate::engine::gpu::Deadline;
use crate::engine::graph::StageTime;
use crate::engine::precision::Precision;
use crate::error::{Error, Result};

/// A picture, and which parts of it are to be looked at.
pub(super) struct Sight<'a> {
    input: &'a Input<'a>,
    /// Whether something touches; `None` where nobody looked.
    contact: Option<bool>,
    windows: Vec<Window>,
    /// Whether these are parts, and not all of it.
    in_parts: bool,
    /// What the network leaves out of them.
    scene: Scene,
    /// Time that it took to look for contact.
    stages: Vec<StageTime>,
}

impl<'a> Sight<'a> {
    /// What `scene` leaves of a picture in which a look for contact gave `look`.
    pub fn new(input: &'a Input<'a>, look: Option<contact::Look>, scene: &Scene) -> Self {
        let (windows, scene) = (vec![input.whole()], *scene);
        let mut own = vec![input.taken()];
        let whole = |stages| Self { input, contact: None, windows, in_parts: false, scene, stages };
        let Some(contact::Look { map, stages, .. }) = look else { return whole(own) };
        own.extend(stages);
        let whole = whole(own);
        let touched = !map.is_empty();
        let parts = match touched && scene.regions {
            true => regions::windows(&map, &input.geometry, &scene),
            false => None,
        };
        let in_parts = parts.is_some();
        let windows = match touched || !scene.contact {
            true => parts.unwrap_or(whole.windows),
            false => Vec::new(),
        };
        Self { contact: Some(touched), windows, in_parts, ..whole }
    }

    /// All of the picture with nothing left out, after a first look took `stages`.
    fn whole(&self, stages: &[StageTime]) -> Self {
        let windows = vec![self.input.whole()];
        Self { windows, in_parts: false, scene: Scene::FULL, stages: stages.to_vec(), ..*self }
    }

    /// What was found in a picture whose windows gave `answers`.
    fn detections(&self, answers: Vec<Seen>, precision: Precision, config: &Config) -> Detections {
        let mut stages = self.stages.clone();
        let (mut found, mut proposals, mut without_deepest) = (Vec::new(), 0, false);
        for Seen { answer, times } in answers {
            found.extend(answer.found);
            proposals += answer.proposals;
            without_deepest |= !answer.deepest;
            for time in times {
                match stages.iter_mut().find(|sum| sum.stage == time.stage) {
                    Some(sum) => sum.time += time.time,
                    None => stages.push(time),
                }
            }
        }
        let found = regions::merged(found, config.iou, config.max_detections);
        let rects = || self.windows.iter().map(|window| self.input.rect(window)).collect();
        Detections {
            contact: self.contact,
            // Where nothing touches it is no part.
            regions: (self.in_parts || self.windows.is_empty()).then(rects),
            without_deepest,
            proposals,
            precision,
            stages,
            ..self.input.report(found)
        }
    }
}

/// What the network said of a window, and the time that it took.
struct Seen {
    answer: Answer,
    times: Vec<StageTime>,
}

/// A window of a picture.
#[derive(Clone, Copy)]
struct Job<'a> {
    input: &'a Input<'a>,
    window: Window,
    /// The window's place among those of its picture.
    part: usize,
    /// Of how many proposals at most the network's last part says what they are.
    proposals: usize,
    /// Whether the deepest scale is looked at.
    deepest: bool,
}

impl Job<'_> {
    /// What runs it, with others like it.
    fn kind(&self, precision: Precision, batch: usize) -> Kind {
        let size = [self.window.height, self.window.width];
        Kind { size, precision, batch, proposals: self.proposals, deepest: self.deepest }
    }
}

/// Looks at pictures; once more in f32 where f16 does not reach.
///
/// # Errors
/// Of each picture, what its run returned, or [`Error::NotFinite`].
pub(super) async fn look_at(
    engines: &Engines,
    config: &Config,
    sights: &[Sight<'_>],
    deadline: Deadline,
) -> Vec<Result<Detections>> {
    let precision = engines.precision();
    let mut found = look_as(engines, config, precision, sights, deadline).await;
    for (found, sight) in found.iter_mut().zip(sights) {
        let overflowed = matches!(found, Err(Error::NotFinite { .. }));
        if overflowed && precision == Precision::F16 {
            let sight = std::slice::from_ref(sight);
            let again = look_as(engines, config, Precision::F32, sight, deadline).await;
            again.into_iter().for_each(|again| *found = again);
        }
    }
    found
}

async fn look_as(
    engines: &Engines,
    config: &Config,
    precision: Precision,
    sights: &[Sight<'_>],
    deadline: Deadline,
) -> Vec<Result<Detections>> {
    let mut found = see(engines, config, precision, sights, deadline).await;
    let (mut places, mut wholes) = (Vec::new(), Vec::new());
    for (at, (found, sight)) in found.iter().zip(sights).enumerate() {
        let Ok(found) = found else { continue };
        let less = sight.in_parts || found.without_deepest || sight.scene.proposals;
        if less && leaves_doubt(found, config) {
            places.push(at);
            wholes.push(sight.whole(&found.stages));
        }
    }
    let again = see(engines, config, precision, &wholes, deadline).await;
    for (at, again) in places.into_iter().zip(again) {
        found[at] = again.map(|again| Detections { looked_again: true, ..again });
    }
    for found in found.iter_mut().flatten() {
        found.detections.retain(|detection| detection.score > config.score);
    }
    found
}

/// Whether a box may pass with nothing left out that does not so far.
fn leaves_doubt(found: &Detections, config: &Config) -> bool {
    found.detections.iter().any(|found| config.is_doubtful(found.score))
}

/// Looks at each picture's windows. What may leave doubt is among the detections.
async fn see(
    engines: &Engines,
    config: &Config,
    precision: Precision,
    sights: &[Sight<'_>],
    deadline: Deadline,
) -> Vec<Result<Detections>> {
    let mut jobs = Vec::new();
    for Sight { input, windows, in_parts, scene, .. } in sights {
        jobs.extend(windows.iter().copied().enumerate().map(|(part, window)| {
            let proposals = scene.proposals([window.height, window.width], *in_parts);
            Job { input, window, part, proposals, deepest: !scene.scales }
        }));
    }
    let mut seen = run_all(engines, precision, &jobs, deadline).await.into_iter();
    let mut found = Vec::new();
    for sight in sights {
        let answers: Vec<_> = seen.by_ref().take(sight.windows.len()).collect();
        let answers: Result<Vec<Seen>> = answers.into_iter().collect();
        found.push(answers.map(|answers| sight.detections(answers, precision, config)));
    }
    found
}

/// Runs the network over each window, those of a kind together as far as they fill a batch.
async fn run_all(
    engines: &Engines,
    precision: Precision,
    jobs: &[Job<'_>],
    deadline: Deadline,
) -> Vec<Result<Seen>> {
    let like = |at: &usize| {
        let Job { window, proposals, deepest, .. } = &jobs[*at];
        (window.height, window.width, *proposals, *deepest)
    };
    let mut order: Vec<usize> = (0..jobs.len()).collect();
    order.sort_by_key(like);
    let mut seen: Vec<Option<Result<Seen>>> = jobs.iter().map(|_| None).collect();
    let most = engines.batch();
    for same in order.chunk_by(|a, b| like(a) == like(b)) {
        for group in same.chunks(most).filter(|group| most > 1 && group.len() == most) {
            let together: Vec<Job> = group.iter().map(|at| jobs[*at]).collect();
            // What goes wrong for all is no picture's own fault: each then runs alone.
            if let Ok(all) = run(engines, precision, &together, deadline).await {
                group.iter().zip(all).for_each(|(at, one)| seen[*at] = Some(one));
            }
        }
    }
    for at in 0..jobs.len() {
        if seen[at].is_none() {
            let alone = run(engines, precision, &jobs[at..=at], deadline).await;
            seen[at] = alone.map_or_else(|e| Some(Err(e)), |one| one.into_iter().next());
        }
    }
    seen.into_iter().flatten().collect()
}

/// Runs the network once over windows of one kind.
///
/// # Errors
/// What the run returns; of each window, [`Error::NotFinite`].
async fn run(
    engines: &Engines,
    precision: Precision,
    jobs: &[Job<'_>],
    deadline: Deadline,
) -> Result<Vec<Result<Seen>>> {
    let Some(first) = jobs.first() else { return Ok(Vec::new()) };
    let (engine, deadline) = deadline.beside(|| engines.engine(first.kind(precision, jobs.len())));
    let engine = engine?;
    let network = &engine.network;
    let crops: Vec<_> =
        jobs.iter().map(|job| job.input.part(&job.window)).collect::<Result<_>>()?;
    let inputs = jobs.iter().zip(&crops);
    let inputs =
        inputs.map(|(job, crop)| [(network.picture, &job.input.pixels), (network.crop, crop)]);
    let inputs: Vec<_> = inputs.collect();
    let given = jobs.iter().zip(&inputs).map(|(job, inputs)| {
        let picture = job.input.borrowed.map(|bytes| (network.picture, bytes));
        Given { inputs, picture }
    });
    let pictures: Vec<_> = given.collect();
    let (values, mut times) = engine.run_all(&pictures, deadline).await?;
    times.iter_mut().for_each(|time| time.time /= jobs.len() as u32);
    let seen = jobs.iter().zip(&values).map(|(job, values)| {
        let answer = job.input.answer(network, values, &job.window, job.part)?;
        Ok(Seen { answer, times: times.clone() })
    });
    Ok(seen.collect())
}
