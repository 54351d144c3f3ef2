//! Which pictures are simulated: to learn from, to calibrate and to test with.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use smr_gpu::simulator::conditions::Distribution;
use smr_gpu::simulator::dataset::Settings;
use smr_gpu::simulator::forced::{Forced, Span};
use smr_gpu::simulator::given::Given;
use smr_gpu::simulator::render::Request;
use smr_gpu::simulator::scene::{Mix, Own};

/// Seeds of one seed's sets, apart from each other and from those of the next.
const SEEDS: u64 = 1000;

/// What a set is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Role {
    /// The network learns from it.
    Train,
    /// Scores and deviations are fitted to it.
    Calibrate,
    /// Shows what came of it: nothing was learnt from it.
    Test,
    /// The same without a snap: something else that is easily taken for one.
    Negative,
}

/// A set of pictures to simulate.
pub(super) struct Set {
    pub role: Role,
    pub name: String,
    pub settings: Settings,
}

/// How a set's light and frames are drawn.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Drawn {
    /// The paper's sensor, or the one that is given.
    Plain,
    /// Sensors of many kinds.
    Wide,
    /// Of these under strong shading.
    Strong,
}

/// What a set's pictures show.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Shown {
    /// Snaps, something else, both or nothing.
    Mixed,
    /// No snap.
    Other,
    /// What is easily taken for the parts, alone, as far as there is such.
    Alike,
}

/// What is learnt from, with its share of the pictures. A third of the wide ones show no snap, and those of other
/// sets none: without them a network sees its parts everywhere, and takes broken ones for whole.
const TRAIN: [(&str, f64, Drawn, Shown); 7] = [
    ("plain", 0.15, Drawn::Plain, Shown::Mixed),
    ("wide", 0.42, Drawn::Wide, Shown::Mixed),
    ("strong", 0.1, Drawn::Strong, Shown::Mixed),
    ("plain-other", 0.02, Drawn::Plain, Shown::Other),
    ("wide-other", 0.05, Drawn::Wide, Shown::Other),
    ("plain-alike", 0.09, Drawn::Plain, Shown::Alike),
    ("wide-alike", 0.17, Drawn::Wide, Shown::Alike),
];
/// What scores and deviations are fitted to: pictures, whatever is learnt from.
const CALIBRATE: [(&str, usize, Drawn); 2] =
    [("plain", 150, Drawn::Plain), ("wide", 250, Drawn::Wide)];

/// How many pictures of what.
pub(super) struct Plan<'a> {
    pub work: &'a Path,
    pub own: &'a Own,
    pub sensor: Option<Arc<Given>>,
    pub seed: u64,
    /// Pictures to learn from.
    pub pictures: usize,
    /// Pictures of each test set; of what is taken for a part half as many.
    pub test: usize,
}

impl Plan<'_> {
    /// All sets, in the order in which they are simulated. The seed of each depends on its place alone.
    pub fn sets(&self) -> Vec<Set> {
        let share = |share: f64| ((self.pictures as f64 * share).round() as usize).max(1);
        let train = TRAIN.map(|(name, part, drawn, shown)| {
            (Role::Train, name.to_owned(), share(part), self.request(drawn, shown))
        });
        let calibrate = CALIBRATE.map(|(name, count, drawn)| {
            let count = count.min(self.pictures);
            (Role::Calibrate, name.to_owned(), count, self.request(drawn, Shown::Mixed))
        });
        let test = [("plain", Drawn::Plain), ("wide", Drawn::Wide)].map(|(name, drawn)| {
            (Role::Test, name.to_owned(), self.test, self.request(drawn, Shown::Mixed))
        });
        let negatives = self.own.negatives.iter().map(|negative| {
            let mut request = self.request(Drawn::Plain, Shown::Alike);
            request.own.negatives = vec![negative.clone()];
            (Role::Negative, negative.name.clone(), self.test.div_ceil(2), request)
        });
        let all = train.into_iter().chain(calibrate).chain(test).chain(negatives);
        (1..)
            .zip(all)
            .map(|(at, (role, name, count, request))| {
                let out = self.work.join(folder(role)).join(&name);
                let seed = self.seed.wrapping_mul(SEEDS).wrapping_add(at);
                Set { role, name, settings: Settings { out, count, seed, request, shard: None } }
            })
            .collect()
    }

    fn request(&self, drawn: Drawn, shown: Shown) -> Request {
        let (mut own, sensor) = (self.own.clone(), self.sensor.clone());
        own.negatives_alone = shown == Shown::Alike;
        let mix = if shown == Shown::Mixed { Mix::Mixed } else { Mix::None };
        let plain = Request { mix, own, ..Request::default() };
        let wide = Request { conditions: Distribution::Wide, ..plain.clone() };
        match (drawn, sensor) {
            (Drawn::Plain, None) => plain,
            (Drawn::Plain, sensor) => {
                let forced = Forced { mild: true, ..Forced::default() };
                Request { sensor, forced, ..wide }
            }
            (Drawn::Wide, _) => wide,
            (Drawn::Strong, _) => {
                let strength = Some(Span { low: 2.0, high: 4.0 });
                Request { forced: Forced { strength, ..Forced::default() }, ..wide }
            }
        }
    }
}

/// The folder of a role's sets below the work folder.
fn folder(role: Role) -> &'static str {
    match role {
        Role::Train => "train",
        Role::Calibrate => "calibration",
        Role::Test => "test",
        Role::Negative => "negatives",
    }
}

/// The folders of a role's sets.
pub(super) fn folders(sets: &[Set], role: Role) -> Vec<PathBuf> {
    let chosen = sets.iter().filter(|set| set.role == role);
    chosen.map(|set| set.settings.out.clone()).collect()
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use smr_gpu::simulator::scene::{Negative, NegativeShape};
    use smr_gpu::simulator::snaps::Kind;

    use super::*;

    #[test]
    fn no_two_sets_share_a_scene() {
        let negative = |kind: Kind| Negative {
            name: kind.name().to_owned(),
            shape: NegativeShape::Snap(kind),
            weight: 1,
            pressed: None,
        };
        let own =
            Own { classes: vec![Kind::A], negatives: vec![negative(Kind::B)], ..Own::default() };
        let sets = |seed| {
            let work = Path::new("work");
            Plan { work, own: &own, sensor: None, seed, pictures: 4000, test: 200 }.sets()
        };
        let all: Vec<Set> = sets(1).into_iter().chain(sets(2)).collect();
        let seeds: HashSet<u64> = all.iter().map(|set| set.settings.seed).collect();
        assert_eq!((all.len(), seeds.len()), (24, 24));
        let train = all[..12].iter().filter(|set| set.role == Role::Train);
        assert_eq!(train.map(|set| set.settings.count).sum::<usize>(), 4000);
        let negative = &all[11].settings.request.own;
        assert!(all[11].role == Role::Negative && negative.negatives_alone);
        assert_eq!(
            folders(&all[..12], Role::Test),
            ["work/test/plain", "work/test/wide"].map(PathBuf::from)
        );
        // Of few pictures each set has one at least.
        let few =
            Plan { work: Path::new("w"), own: &own, sensor: None, seed: 1, pictures: 3, test: 1 };
        assert!(few.sets().iter().all(|set| set.settings.count >= 1));
    }
}
