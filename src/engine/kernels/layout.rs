//! How a tensor's values lie on a device. A layout of maps is stored in either [`Precision`].

use crate::engine::kernels::{Caps, MAX_WORKGROUPS};
use crate::engine::precision::Precision;
use crate::engine::shader::shader_struct;
use crate::engine::shape::TensorSpec;

/// The order of a tensor's values on a device, and what holds them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Layout {
    /// A buffer in the order of the shape. What is no map knows no other.
    Planar,
    /// A buffer with a pixel's channels four by four: see [`Quads`].
    Quads,
    /// The same in a storage texture.
    Texture,
}

/// Bytes to which rows are padded that are copied to textures: so a copy wants them.
const PITCH: u32 = 256;

shader_struct! {
    /// Where the channels of a map `[C, H, W]` lie, four a texel, in a buffer or in a texture; for
    /// `wgsl/shared/quads.wgsl`, too.
    ///
    /// Texel (q, y, x) holds channels 4q to 4q + 3 of pixel (y, x), zeros past the last. Pictures stand one below the
    /// other, and so do quads; where maps are copied to textures, quads stand side by side in so many columns that both
    /// sides fit.
    #[derive(PartialEq, Eq)]
    pub struct Quads {
        /// Pixels of a row.
        pub width: u32,
        /// Rows of a map.
        pub height: u32,
        /// Texels for all channels of a pixel.
        pub quads: u32,
        /// Texels of a row of one quad; those behind the width are undefined.
        pub pitch: u32,
        /// Quads that stand side by side.
        pub columns: u32,
        /// Rows of a picture.
        pub rows: u32,
        /// 0, where a compiler must not know it.
        pub zero: u32,
        /// Channels.
        pub channels: u32,
    }
}

impl Quads {
    /// The arrangement of a map for `batch` pictures in a program that stores maps in `precision`, also of those
    /// that it stores in f32: kernels write a map where another of its size lies. `None` for what is no map
    /// `[C, H, W]`, is too large for the adapter's buffers, or, where it is copied to textures, for those however
    /// it is arranged, or has more rows of quads than a dimension of a grid has workgroups.
    pub fn of(spec: &TensorSpec, precision: Precision, batch: u32, caps: &Caps) -> Option<Self> {
        let [channels, height, width] = <[usize; 3]>::try_from(spec.shape.0.as_slice()).ok()?;
        let [channels, height, width] =
            [channels, height, width].map(|d| u32::try_from(d).unwrap_or(u32::MAX));
        let quads = channels.div_ceil(4);
        let rows = u64::from(quads) * u64::from(height);
        let (pitch, columns) = match caps.input_layout() {
            Layout::Texture => {
                let pitch = width.checked_next_multiple_of(PITCH / precision.texel_bytes())?;
                let most = u64::from(caps.texture_side);
                let stacked = |columns: u32| {
                    u64::from(quads.div_ceil(columns)) * u64::from(height) * u64::from(batch)
                };
                let columns = (1..=quads).find(|columns| stacked(*columns) <= most)?;
                if u64::from(columns) * u64::from(pitch) > most {
                    return None;
                }
                (pitch, columns)
            }
            Layout::Quads | Layout::Planar => (width, 1),
        };
        let fits = rows <= u64::from(MAX_WORKGROUPS) && rows > 0 && width > 0;
        let rows = quads.div_ceil(columns) * height;
        let found = Self { width, height, quads, pitch, columns, rows, zero: 0, channels };
        (fits && found.most_bytes(batch) <= caps.buffer_bytes).then_some(found)
    }

    /// Bytes of a buffer for `batch` pictures in f32, which f16 takes half of.
    pub fn most_bytes(&self, batch: u32) -> u64 {
        self.texels() * u64::from(Precision::F32.texel_bytes()) * u64::from(batch)
    }

    /// Width of the texture.
    pub fn texture_width(&self) -> u32 {
        self.columns * self.pitch
    }

    /// Texels of a picture.
    pub fn texels(&self) -> u64 {
        u64::from(self.texture_width()) * u64::from(self.rows)
    }

    /// The values of a picture in the order of the shape, from its texels.
    pub fn unpack(&self, texels: &[f32]) -> Vec<f32> {
        let mut planar = Vec::with_capacity((self.channels * self.height * self.width) as usize);
        for c in 0..self.channels {
            let (q, part) = (c / 4, c % 4);
            for y in 0..self.height {
                let row = q / self.columns * self.height + y;
                let first = row * self.texture_width() + q % self.columns * self.pitch;
                let texel = |x: u32| texels[((first + x) * 4 + part) as usize];
                planar.extend((0..self.width).map(texel));
            }
        }
        planar
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::kernels::Kind;

    /// Of an adapter that reads textures.
    fn caps(texture_side: u32) -> Caps {
        Caps { texture_side, kind: Kind::Software, ..Caps::default() }
    }

    /// Nothing but the texels that there are.
    #[test]
    fn maps_that_stay_in_buffers_have_no_padding() {
        for precision in [Precision::F32, Precision::F16] {
            let of = |buffer_bytes| {
                let caps = Caps { texture_side: 64, buffer_bytes, ..Caps::default() };
                Quads::of(&TensorSpec::f32([10, 5, 100]), precision, 7, &caps)
            };
            let map = of(168_000).expect("3 quads of 5 × 100 texels for 7 pictures in f32");
            assert_eq!((map.quads, map.pitch, map.columns, map.rows), (3, 100, 1, 15));
            assert_eq!(of(167_999), None, "{precision}");
        }
        assert_eq!(
            Quads::of(&TensorSpec::f32([0, 5, 5]), Precision::F32, 1, &Caps::default()),
            None
        );
    }

    #[test]
    fn quads_stand_side_by_side_where_a_column_is_too_high() {
        let spec = TensorSpec::f32([10, 5, 20]);
        let of = |batch, side| Quads::of(&spec, Precision::F32, batch, &caps(side));
        let one = of(1, 64).expect("a map that fits");
        assert_eq!((one.quads, one.pitch, one.columns, one.rows), (3, 32, 1, 15));
        let two = of(4, 64).expect("a map that fits");
        assert_eq!((two.columns, two.rows, two.texture_width()), (1, 15, 32));
        let two = of(5, 64).expect("a map that fits");
        assert_eq!((two.columns, two.rows, two.texture_width()), (2, 10, 64));
        assert_eq!(of(7, 64), None, "3 columns are 96 texels wide");
        let other = |spec, side| Quads::of(&spec, Precision::F32, 1, &caps(side));
        assert_eq!(other(TensorSpec::f32([10, 5]), 64), None);
        let rows = |quads: usize| other(TensorSpec::f32([4 * quads, 1, 1]), 8192);
        assert!(rows(65_535).is_some() && rows(65_536).is_none(), "a grid's longest side");
    }

    /// 2 × 15 rows of 32 texels: 15 360 bytes in f32, in which a program of f16 stores some maps too.
    #[test]
    fn all_pictures_fit_a_buffer() {
        let spec = TensorSpec::f32([10, 5, 20]);
        for precision in [Precision::F32, Precision::F16] {
            let of = |buffer_bytes| {
                let caps = Caps { buffer_bytes, ..caps(8192) };
                Quads::of(&spec, precision, 2, &caps)
            };
            assert!(of(15_360).is_some() && of(15_359).is_none(), "{precision}");
        }
    }

    /// A row of 20 texels of 8 bytes fills one of 256 bytes, one of 33 two.
    #[test]
    fn rows_of_halves_are_padded_to_the_same_bytes() {
        for (width, pitch) in [(20, 32), (32, 32), (33, 64)] {
            let spec = TensorSpec::f32([4, 1, width]);
            let quads = Quads::of(&spec, Precision::F16, 1, &caps(64)).expect("a map that fits");
            assert_eq!(quads.pitch, pitch);
        }
    }

    #[test]
    fn unpacking_finds_each_channel() {
        let spec = TensorSpec::f32([6, 2, 3]);
        let quads = Quads::of(&spec, Precision::F32, 1, &caps(32)).expect("a map that fits");
        let mut texels = vec![f32::NAN; quads.texels() as usize * 4];
        // Channel c of pixel (y, x) is 100c + 10y + x.
        for (c, y, x) in (0..36).map(|i| (i / 6, i / 3 % 2, i % 3)) {
            texels[((c / 4 * 2 + y) * 16 + x) * 4 + c % 4] = (100 * c + 10 * y + x) as f32;
        }
        let expected = (0..36).map(|i| (i / 6 * 100 + i / 3 % 2 * 10 + i % 3) as f32);
        assert_eq!(quads.unpack(&texels), expected.collect::<Vec<_>>());
    }
}
