//! The contract's comments, for the OpenAPI document.

use percept_wire::json;
use std::collections::HashMap;

/// Comments by file and path in it, as `FileDescriptorProto` numbers them.
pub(super) struct Comments(HashMap<(String, Vec<i32>), String>);

impl Comments {
    /// Of the whole contract.
    pub(super) fn of_contract() -> Self {
        let mut all = HashMap::new();
        for file in json::pool().files() {
            let proto = file.file_descriptor_proto();
            for place in proto.source_code_info.iter().flat_map(|i| &i.location) {
                let words = flowing(
                    place.leading_comments.as_deref().or(place.trailing_comments.as_deref()).unwrap_or_default(),
                );
                if !words.is_empty() {
                    all.insert((file.name().to_owned(), place.path.clone()), words);
                }
            }
        }
        Self(all)
    }

    /// The comment at a place; empty if there is none.
    pub(super) fn at(&self, file: &str, path: &[i32]) -> &str {
        self.0.get(&(file.to_owned(), path.to_vec())).map(String::as_str).unwrap_or_default()
    }
}

/// Lines of a comment as one line.
fn flowing(comment: &str) -> String {
    comment.lines().map(str::trim).filter(|l| !l.is_empty()).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn comments_are_found_where_they_stand() {
        let comments = Comments::of_contract();
        let box_ = json::descriptor("OrientedBox").unwrap();
        let file = box_.parent_file();
        assert_eq!(comments.at(file.name(), box_.path()), "A box with a pose.");
        let size = box_.get_field_by_name("size_m").unwrap();
        assert!(comments.at(file.name(), size.path()).contains("metres"));
        assert_eq!(comments.at("none", &[]), "");
    }
}
