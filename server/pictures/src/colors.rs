//! Colours that people with any colour vision tell apart, and scales whose lightness rises evenly.
//!
//! Categories are from Okabe and Ito, "Color universal design", 2008. Scales are viridis (van der Walt and Smith, 2015) and
//! cividis (Nuñez, Anderton and Renslow, "Optimizing colormaps with consideration for color vision deficiency", 2018), every
//! eighth colour of the tables that matplotlib publishes (CC0), and linear between.

/// RGB8.
pub(crate) type Color = [u8; 3];

pub(crate) const PAPER: Color = [255, 255, 255];
pub(crate) const INK: Color = [28, 30, 34];
pub(crate) const SOFT_INK: Color = [96, 100, 108];
pub(crate) const GRID_LINE: Color = [226, 229, 233];

/// Cells of which nothing is known: bluish, so that no probability looks like it.
pub(crate) const UNKNOWN: Color = [200, 207, 218];
pub(crate) const FREE: Color = [255, 255, 255];
pub(crate) const OCCUPIED: Color = [20, 20, 22];

pub(crate) const BLUE: Color = [0, 114, 178];
pub(crate) const SKY: Color = [86, 180, 233];
pub(crate) const GREEN: Color = [0, 158, 115];
pub(crate) const AMBER: Color = [230, 159, 0];
pub(crate) const VERMILION: Color = [213, 94, 0];
pub(crate) const PURPLE: Color = [204, 121, 167];
pub(crate) const MAGENTA: Color = [200, 0, 140];
pub(crate) const RED: Color = [204, 24, 30];

/// From dark to light over the range from 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Scale {
    Viridis,
    Cividis,
    /// Dark red, not passable, over yellow to bluish green: the ends differ in lightness and in blue, too.
    Traversability,
}

impl Scale {
    /// Colour at a share from 0 to 1; beyond, the end's; that of 0 for NaN.
    pub(crate) fn at(self, share: f64) -> Color {
        let table: &[Color] = match self {
            Self::Viridis => &VIRIDIS,
            Self::Cividis => &CIVIDIS,
            Self::Traversability => &TRAVERSABILITY,
        };
        let share = if share.is_nan() { 0.0 } else { share.clamp(0.0, 1.0) };
        let place = share * (table.len() - 1) as f64;
        let i = (place as usize).min(table.len() - 2);
        mix(table[i], table[i + 1], place - i as f64)
    }
}

/// `a` at share 0, `b` at 1.
pub(crate) fn mix(a: Color, b: Color, share: f64) -> Color {
    std::array::from_fn(|i| (f64::from(a[i]) + (f64::from(b[i]) - f64::from(a[i])) * share).round() as u8)
}

/// Darker below 1.
pub(crate) fn scaled(color: Color, by: f64) -> Color {
    color.map(|c| (f64::from(c) * by).round().clamp(0.0, 255.0) as u8)
}

/// Of a cell: -1 unknown, 0 free to 100 occupied; whatever is nearer to one of the ends looks like it.
pub(crate) fn occupancy(percent: i8) -> Color {
    match percent {
        ..0 => UNKNOWN,
        0..=50 => mix(FREE, [225; 3], f64::from(percent) / 50.0),
        _ => mix([130; 3], OCCUPIED, (f64::from(percent.min(100)) - 50.0) / 50.0),
    }
}

const TRAVERSABILITY: [Color; 5] = [[128, 20, 16], [206, 84, 38], [244, 214, 90], [112, 186, 110], [0, 140, 105]];

const VIRIDIS: [Color; 33] = [
    [68, 1, 84],
    [71, 13, 96],
    [72, 24, 106],
    [72, 35, 116],
    [71, 45, 123],
    [69, 55, 129],
    [66, 64, 134],
    [62, 73, 137],
    [59, 82, 139],
    [55, 91, 141],
    [51, 99, 141],
    [47, 107, 142],
    [44, 114, 142],
    [41, 122, 142],
    [38, 130, 142],
    [35, 137, 142],
    [33, 145, 140],
    [31, 151, 139],
    [31, 159, 136],
    [33, 166, 133],
    [39, 173, 129],
    [49, 181, 123],
    [61, 188, 116],
    [76, 194, 108],
    [92, 200, 99],
    [110, 206, 88],
    [129, 211, 77],
    [149, 216, 64],
    [170, 220, 50],
    [192, 223, 37],
    [213, 226, 26],
    [234, 229, 26],
    [253, 231, 37],
];

const CIVIDIS: [Color; 33] = [
    [0, 34, 78],
    [0, 40, 91],
    [0, 46, 106],
    [5, 51, 113],
    [26, 56, 111],
    [39, 62, 110],
    [50, 67, 109],
    [59, 73, 108],
    [67, 78, 108],
    [75, 84, 108],
    [83, 90, 109],
    [90, 95, 110],
    [97, 101, 111],
    [104, 106, 113],
    [111, 112, 115],
    [118, 118, 118],
    [125, 124, 120],
    [131, 129, 121],
    [139, 135, 120],
    [146, 141, 120],
    [154, 147, 118],
    [162, 153, 117],
    [170, 160, 115],
    [179, 166, 112],
    [187, 173, 109],
    [195, 179, 105],
    [204, 186, 100],
    [212, 193, 95],
    [221, 200, 88],
    [230, 208, 81],
    [239, 215, 72],
    [248, 223, 60],
    [254, 232, 56],
];

#[cfg(test)]
mod tests {
    use super::*;

    /// ITU-R BT.709, without gamma: enough for an order.
    fn lightness(c: Color) -> f64 {
        0.2126 * f64::from(c[0]) + 0.7152 * f64::from(c[1]) + 0.0722 * f64::from(c[2])
    }

    #[test]
    fn scales_become_lighter_all_the_way() {
        for scale in [Scale::Viridis, Scale::Cividis] {
            let all: Vec<f64> = (0..=100).map(|i| lightness(scale.at(f64::from(i) / 100.0))).collect();
            assert!(all.windows(2).all(|p| p[1] > p[0] - 1.0), "{scale:?}");
        }
        assert_eq!(Scale::Viridis.at(-3.0), [68, 1, 84]);
        assert_eq!(Scale::Viridis.at(7.0), [253, 231, 37]);
        assert_eq!(Scale::Viridis.at(f64::NAN), [68, 1, 84]);
    }

    #[test]
    fn no_probability_looks_unknown() {
        let grey = |p: i8| occupancy(p).iter().all(|c| c.abs_diff(occupancy(p)[0]) < 6);
        assert!((0..=127).all(grey));
        assert_eq!((occupancy(-1), occupancy(0), occupancy(100)), (UNKNOWN, FREE, OCCUPIED));
    }
}
