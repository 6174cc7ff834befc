//! Detectors of things in images, whatever they run on.

use super::Detection2d;
use percept_geometry::RgbImage;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Finds things in images.
pub trait ImageDetector: std::fmt::Debug + Send + Sync {
    /// The things in an image, pixels, best score first; the same for the same image.
    ///
    /// # Errors
    /// Why it cannot say, in words.
    fn detect(&self, image: &RgbImage) -> Result<Vec<Detection2d>, String>;

    /// What it tells apart.
    fn labels(&self) -> &[String];
}

/// Detectors by name. Clones share them.
#[derive(Debug, Clone, Default)]
pub struct ImageDetectors(Arc<BTreeMap<String, Arc<dyn ImageDetector>>>);

impl ImageDetectors {
    /// These.
    pub fn new(by_name: BTreeMap<String, Arc<dyn ImageDetector>>) -> Self {
        Self(Arc::new(by_name))
    }

    /// The one of a name.
    pub fn get(&self, name: &str) -> Option<Arc<dyn ImageDetector>> {
        self.0.get(name).cloned()
    }

    /// All, by name.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &dyn ImageDetector)> {
        self.0.iter().map(|(name, detector)| (name.as_str(), &**detector))
    }
}
