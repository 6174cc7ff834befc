//! Rows of figures, and what they come to.

/// Figures of one world by name; NaN where there is none.
pub(crate) type Row = Vec<(&'static str, f64)>;

/// Rows are printed as they come.
#[derive(Default)]
pub(crate) struct Table {
    rows: Vec<Row>,
}

impl Table {
    pub(crate) fn add(&mut self, name: &str, row: Row) {
        if self.rows.is_empty() {
            println!("columns: {}", row.iter().map(|(name, _)| *name).collect::<Vec<_>>().join(" | "));
        }
        println!("{name}: {}", row.iter().map(|(_, v)| told(*v)).collect::<Vec<_>>().join(" "));
        self.rows.push(row);
    }

    /// Mean, median, least and greatest of each column, of the worlds that have it.
    pub(crate) fn summary(&self, name: &str) {
        let Some(first) = self.rows.first() else { return };
        println!("{name}, {} worlds: mean, p50, least, greatest", self.rows.len());
        for (i, (column, _)) in first.iter().enumerate() {
            let mut values: Vec<f64> = self.rows.iter().map(|row| row[i].1).filter(|v| !v.is_nan()).collect();
            values.sort_by(f64::total_cmp);
            let mean = values.iter().sum::<f64>() / values.len() as f64;
            let at = |share: f64| quantile(&values, share);
            println!("  {column:<52} {} {} {} {}", told(mean), told(at(0.5)), told(at(0.0)), told(at(1.0)));
        }
    }
}

/// Of values in ascending order; NaN of none.
pub(crate) fn quantile(sorted: &[f64], share: f64) -> f64 {
    sorted.get((sorted.len().saturating_sub(1) as f64 * share).round() as usize).copied().unwrap_or(f64::NAN)
}

/// Part of a whole; NaN of an empty one.
pub(crate) fn share(part: usize, whole: usize) -> f64 {
    if whole == 0 { f64::NAN } else { part as f64 / whole as f64 }
}

fn told(v: f64) -> String {
    if v.fract() == 0.0 { format!("{v:>8.0}") } else { format!("{v:>8.4}") }
}
