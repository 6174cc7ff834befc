//! Where each setting came from, so that a complaint about it can say so.

use std::collections::BTreeMap;
use std::path::Path;
use toml::de::{DeTable, DeValue};

/// Paths of fields with where they were set; what is absent has its default.
#[derive(Debug, Default)]
pub(super) struct Origins(BTreeMap<String, String>);

impl Origins {
    /// Notes every field of a file. A file that is not TOML leaves nothing: its reader complains.
    pub(super) fn file(&mut self, path: &Path, text: &str) {
        if let Ok(table) = DeTable::parse(text) {
            self.table("", table.get_ref(), &|at| {
                let line = 1 + text.bytes().take(at).filter(|&byte| byte == b'\n').count();
                format!("{}:{line}", path.display())
            });
        }
    }

    fn table(&mut self, prefix: &str, table: &DeTable<'_>, place: &impl Fn(usize) -> String) {
        for (key, value) in table {
            let field = format!("{prefix}{}", key.get_ref());
            if let DeValue::Table(inner) = value.get_ref() {
                self.table(&format!("{field}."), inner, place);
            } else {
                self.0.insert(field, place(key.span().start));
            }
        }
    }

    /// Notes a field set by a variable.
    pub(super) fn variable(&mut self, field: &str, name: &str) {
        self.0.insert(field.to_owned(), format!("environment {name}"));
    }

    /// Where `field` was set. The complaint may leave out steps in the middle of the path (`params.map.range_max_m`
    /// for `params.map.occupancy.range_max_m`): then the only field that fits.
    pub(super) fn of(&self, field: &str) -> Option<String> {
        if let Some(origin) = self.0.get(field) {
            return Some(origin.clone());
        }
        let (section, leaf) = field.rsplit_once('.')?;
        let leaf = format!(".{leaf}");
        let mut fits = self.0.iter().filter(|(known, _)| known.starts_with(section) && known.ends_with(&leaf));
        fits.next().filter(|_| fits.next().is_none()).map(|(_, origin)| origin.clone())
    }
}
