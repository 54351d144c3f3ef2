//! A run's share of a list of files, where several runs do one list together.

use std::str::FromStr;

/// One of `of` runs, which take a list's files in turn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    /// From 1 to `of`.
    number: u64,
    of: u64,
}

/// A text that names no [`Shard`].
#[derive(Debug, thiserror::Error)]
#[error("expected i/n with 1 ≤ i ≤ n, got {0}")]
pub struct NoShard(String);

impl Shard {
    /// Whether this run takes the file of that index, from 0.
    pub fn takes(self, index: u64) -> bool {
        index % self.of == self.number - 1
    }

    /// How many of so many files it takes.
    pub fn share(self, all: u64) -> u64 {
        all / self.of + u64::from(all % self.of >= self.number)
    }
}

impl FromStr for Shard {
    type Err = NoShard;

    fn from_str(text: &str) -> Result<Self, NoShard> {
        let shard = text.split_once('/').and_then(|(number, of)| {
            Some(Self { number: number.parse().ok()?, of: of.parse().ok()? })
        });
        shard
            .filter(|shard| (1..=shard.of).contains(&shard.number))
            .ok_or_else(|| NoShard(text.to_owned()))
    }
}

impl std::fmt::Display for Shard {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}/{}", self.number, self.of)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shards_take_each_file_once() {
        let shards = ["1/3", "2/3", "3/3"].map(|text| text.parse::<Shard>().expect(text));
        let taken = shards.map(|shard| (0..8).filter(|i| shard.takes(*i)).collect::<Vec<_>>());
        assert_eq!(taken, [vec![0, 3, 6], vec![1, 4, 7], vec![2, 5]]);
        assert_eq!(shards.map(|shard| shard.share(8)), [3, 3, 2]);
        assert_eq!(shards.map(|shard| shard.share(2)), [1, 1, 0]);
        assert_eq!(shards[1].to_string(), "2/3");
    }

    #[test]
    fn what_is_no_shard_is_refused() {
        for text in ["", "1", "0/2", "3/2", "1/0", "-1/2", "1/2/3", "a/b", "1 /2"] {
            let message = text.parse::<Shard>().expect_err(text).to_string();
            assert_eq!(message, format!("expected i/n with 1 ≤ i ≤ n, got {text}"));
        }
    }
}
