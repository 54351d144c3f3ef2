//! Runs the network over pictures or their regions, those of a size together.

use crate::detector::contact_map::Contact;
use crate::detector::geometry::Region;
use crate::detector::input::Input;
use crate::detector::output::RegionOutput;
use crate::detector::regions;
use crate::detector::runner::Given;
use crate::detector::session::{Key, Session};
use crate::detector::{Config, Detections, Savings};
use crate::engine::gpu::Deadline;
use crate::engine::graph::StageTime;
use crate::engine::precision::Precision;
use crate::error::{Error, Result};

/// A picture, and which regions of it the network runs on.
pub(crate) struct Job<'a> {
    input: &'a Input<'a>,
    /// Whether something touches; `None` where that was not asked.
    contact: Option<bool>,
    regions: Vec<Region>,
    /// Whether these are less than all of it.
    in_regions: bool,
    /// What the network leaves out of them.
    savings: Savings,
    /// Time that the contact map took.
    stages: Vec<StageTime>,
}

impl<'a> Job<'a> {
    /// What `savings` leaves of a picture with this contact.
    pub fn new(input: &'a Input<'a>, contact: Option<Contact>, savings: &Savings) -> Self {
        let (regions, savings) = (vec![input.whole()], *savings);
        let mut own = vec![input.taken()];
        let whole =
            |stages| Self { input, contact: None, regions, in_regions: false, savings, stages };
        let Some(Contact { tiles, stages, .. }) = contact else { return whole(own) };
        own.extend(stages);
        let whole = whole(own);
        let touched = !tiles.is_empty();
        let parts = match touched && savings.regions {
            true => regions::regions(&tiles, &input.geometry, &savings),
            false => None,
        };
        let in_regions = parts.is_some();
        let regions = match touched || !savings.contact {
            true => parts.unwrap_or(whole.regions),
            false => Vec::new(),
        };
        Self { contact: Some(touched), regions, in_regions, ..whole }
    }

    /// All of the picture with nothing left out, after a first run took `stages`.
    fn whole(&self, stages: &[StageTime]) -> Self {
        let regions = vec![self.input.whole()];
        Self {
            regions,
            in_regions: false,
            savings: Savings::NONE,
            stages: stages.to_vec(),
            ..*self
        }
    }

    /// What was found in a picture whose regions gave `results`.
    fn detections(
        &self,
        results: Vec<RegionResult>,
        precision: Precision,
        config: &Config,
    ) -> Detections {
        let mut stages = self.stages.clone();
        let (mut found, mut proposals, mut without_deepest) = (Vec::new(), 0, false);
        for RegionResult { output, times } in results {
            found.extend(output.detections);
            proposals += output.proposals;
            without_deepest |= !output.deepest;
            for time in times {
                match stages.iter_mut().find(|sum| sum.stage == time.stage) {
                    Some(sum) => sum.time += time.time,
                    None => stages.push(time),
                }
            }
        }
        let found = regions::merged(found, config.iou, config.max_detections);
        let rects = || self.regions.iter().map(|region| self.input.rect(region)).collect();
        Detections {
            contact: self.contact,
            // Without contact there is none.
            regions: (self.in_regions || self.regions.is_empty()).then(rects),
            without_deepest,
            proposals,
            precision,
            stages,
            ..self.input.report(found)
        }
    }
}

/// What the network gave for a region, and the time that it took.
struct RegionResult {
    output: RegionOutput,
    times: Vec<StageTime>,
}

/// A region of a picture.
#[derive(Clone, Copy)]
struct RegionJob<'a> {
    input: &'a Input<'a>,
    region: Region,
    /// The region's place among those of its picture.
    part: usize,
    /// Of how many proposals at most the network's last part says what they are.
    proposals: usize,
    /// Whether the deepest scale is computed.
    deepest: bool,
}

impl RegionJob<'_> {
    /// What runs it, with others like it.
    fn key(&self, precision: Precision, batch: usize) -> Key {
        let size = [self.region.height, self.region.width];
        Key { size, precision, batch, proposals: self.proposals, deepest: self.deepest }
    }
}

/// Runs pictures; once more in f32 where f16 does not reach.
///
/// # Errors
/// Of each picture, what its run returned, or [`Error::NotFinite`].
pub(super) async fn run_jobs(
    session: &Session,
    config: &Config,
    jobs: &[Job<'_>],
    deadline: Deadline,
) -> Vec<Result<Detections>> {
    let precision = session.precision();
    let mut found = run_jobs_in(session, config, precision, jobs, deadline).await;
    for (found, job) in found.iter_mut().zip(jobs) {
        let overflowed = matches!(found, Err(Error::NotFinite { .. }));
        if overflowed && precision == Precision::F16 {
            let job = std::slice::from_ref(job);
            let again = run_jobs_in(session, config, Precision::F32, job, deadline).await;
            again.into_iter().for_each(|again| *found = again);
        }
    }
    found
}

async fn run_jobs_in(
    session: &Session,
    config: &Config,
    precision: Precision,
    jobs: &[Job<'_>],
    deadline: Deadline,
) -> Vec<Result<Detections>> {
    let mut found = run_regions(session, config, precision, jobs, deadline).await;
    let (mut places, mut wholes) = (Vec::new(), Vec::new());
    for (at, (found, job)) in found.iter().zip(jobs).enumerate() {
        let Ok(found) = found else { continue };
        let less = job.in_regions || found.without_deepest || job.savings.proposals;
        if less && leaves_doubt(found, config) {
            places.push(at);
            wholes.push(job.whole(&found.stages));
        }
    }
    let again = run_regions(session, config, precision, &wholes, deadline).await;
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

/// Runs each picture's regions. What may leave doubt is among the detections.
async fn run_regions(
    session: &Session,
    config: &Config,
    precision: Precision,
    jobs: &[Job<'_>],
    deadline: Deadline,
) -> Vec<Result<Detections>> {
    let mut region_jobs = Vec::new();
    for Job { input, regions, in_regions, savings, .. } in jobs {
        region_jobs.extend(regions.iter().copied().enumerate().map(|(part, region)| {
            let proposals = savings.proposals([region.height, region.width], *in_regions);
            RegionJob { input, region, part, proposals, deepest: !savings.scales }
        }));
    }
    let mut results = run_all(session, precision, &region_jobs, deadline).await.into_iter();
    let mut found = Vec::new();
    for job in jobs {
        let results: Vec<_> = results.by_ref().take(job.regions.len()).collect();
        let results: Result<Vec<RegionResult>> = results.into_iter().collect();
        found.push(results.map(|results| job.detections(results, precision, config)));
    }
    found
}

/// Runs the network over each region, those of a kind together as far as they fill a batch.
async fn run_all(
    session: &Session,
    precision: Precision,
    region_jobs: &[RegionJob<'_>],
    deadline: Deadline,
) -> Vec<Result<RegionResult>> {
    let like = |at: &usize| {
        let RegionJob { region, proposals, deepest, .. } = &region_jobs[*at];
        (region.height, region.width, *proposals, *deepest)
    };
    let mut order: Vec<usize> = (0..region_jobs.len()).collect();
    order.sort_by_key(like);
    let mut results: Vec<Option<Result<RegionResult>>> = region_jobs.iter().map(|_| None).collect();
    let most = session.batch();
    for same in order.chunk_by(|a, b| like(a) == like(b)) {
        for group in same.chunks(most).filter(|group| most > 1 && group.len() == most) {
            let together: Vec<RegionJob> = group.iter().map(|at| region_jobs[*at]).collect();
            // What goes wrong for all is no picture's own fault: each then runs alone.
            if let Ok(all) = run(session, precision, &together, deadline).await {
                group.iter().zip(all).for_each(|(at, one)| results[*at] = Some(one));
            }
        }
    }
    for at in 0..region_jobs.len() {
        if results[at].is_none() {
            let alone = run(session, precision, &region_jobs[at..=at], deadline).await;
            results[at] = alone.map_or_else(|e| Some(Err(e)), |one| one.into_iter().next());
        }
    }
    results.into_iter().flatten().collect()
}

/// Runs the network once over regions of one kind.
///
/// # Errors
/// What the run returns; of each region, [`Error::NotFinite`].
async fn run(
    session: &Session,
    precision: Precision,
    region_jobs: &[RegionJob<'_>],
    deadline: Deadline,
) -> Result<Vec<Result<RegionResult>>> {
    let Some(first) = region_jobs.first() else { return Ok(Vec::new()) };
    let (engine, deadline) =
        deadline.beside(session.compiled(first.key(precision, region_jobs.len()))).await;
    let engine = engine?;
    let network = &engine.network;
    let crops: Vec<_> = region_jobs
        .iter()
        .map(|region_job| region_job.input.part(&region_job.region))
        .collect::<Result<_>>()?;
    let inputs = region_jobs.iter().zip(&crops);
    let inputs = inputs.map(|(region_job, crop)| {
        [(network.picture, &region_job.input.pixels), (network.crop, crop)]
    });
    let inputs: Vec<_> = inputs.collect();
    let given = region_jobs.iter().zip(&inputs).map(|(region_job, inputs)| {
        let picture = region_job.input.borrowed.map(|bytes| (network.picture, bytes));
        Given { inputs, picture }
    });
    let pictures: Vec<_> = given.collect();
    let (values, mut times) = engine.run_all(&pictures, deadline).await?;
    times.iter_mut().for_each(|time| time.time /= region_jobs.len() as u32);
    let results = region_jobs.iter().zip(&values).map(|(region_job, values)| {
        let output =
            region_job.input.output(network, values, &region_job.region, region_job.part)?;
        Ok(RegionResult { output, times: times.clone() })
    });
    Ok(results.collect())
}
