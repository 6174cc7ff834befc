//! Round numbers: 1, 2 or 5 times a power of ten.

/// The largest round number that is not above `value`, which is positive; 1 for what is none.
pub(crate) fn round_below(value: f64) -> f64 {
    if !(value.is_finite() && value > 0.0) {
        return 1.0;
    }
    let power = 10f64.powi(value.log10().floor() as i32);
    // A thousandth of a per cent of grace for logarithms that are off by a bit.
    let fits = |m: &f64| m * power <= value * 1.00001;
    [10.0, 5.0, 2.0, 1.0].into_iter().find(fits).unwrap_or(0.5) * power
}

/// The smallest round number that is not below `value`.
fn round_above(value: f64) -> f64 {
    let below = round_below(value);
    [1.0, 2.0, 2.5, 5.0, 10.0]
        .map(|m| round_below(m * below))
        .into_iter()
        .find(|r| *r >= value * 0.99999)
        .unwrap_or(below)
}

/// Round numbers from `low` to `high`, both included, at least `apart` from each other, as they are written. At most 200.
pub(crate) fn ticks_within(low: f64, high: f64, apart: f64) -> Vec<(f64, String)> {
    if !(low.is_finite() && high.is_finite() && apart.is_finite() && apart > 0.0 && low <= high) {
        return vec![];
    }
    let step = round_above(apart);
    let slack = 1e-6 * step;
    let (first, last) = (((low - slack) / step).ceil() as i64, ((high + slack) / step).floor() as i64);
    let decimals = (-step.log10().floor()).clamp(0.0, 9.0) as usize;
    (first..=last.min(first.saturating_add(199)))
        .map(|i| {
            let value = i as f64 * step;
            let label = if value.abs() < 1e7 { format!("{value:.decimals$}") } else { format!("{value:.3e}") };
            (value, label)
        })
        .collect()
}

/// A length as people say it: `50 cm`, `2 m`, `1 km`.
pub(crate) fn in_metres(length: f64) -> String {
    let plain = |v: f64, unit: &str| format!("{} {unit}", (v * 1000.0).round() / 1000.0);
    match length {
        l if l >= 1e6 => format!("{:.0e} km", l / 1000.0),
        l if l >= 1000.0 => plain(l / 1000.0, "km"),
        l if l >= 0.9999 => plain(l, "m"),
        l if l >= 0.0099 => plain(l * 100.0, "cm"),
        l if l >= 1e-6 => plain(l * 1000.0, "mm"),
        l => format!("{l:.0e} m"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn round_numbers_are_one_two_or_five() {
        let below = [(0.7, 0.5), (1.0, 1.0), (3.0, 2.0), (9.9, 5.0), (1000.0, 1000.0), (0.001, 0.001)];
        for (value, expected) in below {
            assert!((round_below(value) / expected - 1.0).abs() < 1e-9, "{value}: {}", round_below(value));
        }
        let above = [(0.7, 1.0), (1.0, 1.0), (3.0, 5.0), (1.2, 2.0), (5.1, 10.0)];
        for (value, expected) in above {
            assert!((round_above(value) / expected - 1.0).abs() < 1e-9, "{value}: {}", round_above(value));
        }
        assert_eq!(round_below(f64::NAN), 1.0);
    }

    #[test]
    fn lengths_are_said_in_their_unit() {
        let said = [(0.05, "5 cm"), (0.5, "50 cm"), (1.0, "1 m"), (20.0, "20 m"), (2000.0, "2 km"), (0.002, "2 mm")];
        said.iter().for_each(|(length, words)| assert_eq!(in_metres(*length), *words));
    }

    #[test]
    fn ticks_stand_at_round_numbers_of_the_range() {
        let labels = |low, high, apart| ticks_within(low, high, apart).into_iter().map(|t| t.1).collect::<Vec<_>>();
        assert_eq!(labels(-0.3, 1.27, 0.4), ["0.0", "0.5", "1.0"]);
        assert_eq!(labels(0.0, 10.0, 5.0), ["0", "5", "10"]);
        assert!(labels(f64::NAN, 1.0, 1.0).is_empty());
        assert!(labels(0.0, 1e300, 1e-300).len() <= 200);
    }
}
