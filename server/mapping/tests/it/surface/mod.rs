//! The surface against closed forms.

mod grid;
mod map;
mod scenes;
mod stored;
