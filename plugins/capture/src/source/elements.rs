//! Looks up the elements that a GStreamer pipeline names in GStreamer's registry. No pipeline is built and no device is opened.

/// Names of the elements of a pipeline: the first word at the start and after each `!`. Anything that is not clearly an element (caps, pads, bins) is
/// left out.
pub fn names(pipeline: &str) -> Vec<&str> {
    let (mut quote, mut escaped) = (None, false);
    // A quoted text may hold `!`.
    let parts = pipeline.split(|c: char| {
        if std::mem::take(&mut escaped) {
            return false;
        }
        match (quote, c) {
            (_, '\\') => escaped = true,
            (None, '"' | '\'') => quote = Some(c),
            (Some(open), _) if open == c => quote = None,
            _ => {}
        }
        c == '!' && quote.is_none()
    });
    let is_name = |word: &&str| {
        word.starts_with(|c: char| c.is_ascii_alphabetic())
            && word.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-')
    };
    parts.filter_map(|part| part.split_whitespace().next()).filter(is_name).collect()
}

/// Quotes a value of a property for a pipeline's text, whatever it contains.
pub fn quoted(value: &str) -> String {
    format!("\"{}\"", value.replace('\\', "\\\\").replace('"', "\\\""))
}

/// The first of `names` that is not installed; `None` also when that is unknown.
pub fn missing<'t>(names: &[&'t str]) -> Option<&'t str> {
    names.iter().copied().find(|name| panoscope_media::is_installed(name) == Some(false))
}

/// The first element of a pipeline that is not installed; `None` also when that is unknown.
pub fn unknown_element(pipeline: &str) -> Option<&str> {
    missing(&names(pipeline))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn elements_are_told_from_caps_and_pads() {
        let text = "v4l2src device=/dev/video0 ! video/x-raw,width=640 ! tee name=t t. ! queue ! appsink t. ! fakesink";
        assert_eq!(names(text), ["v4l2src", "tee", "queue", "appsink", "fakesink"]);
        let text = r#"filesrc location="a ! \" ! b.mkv" ! 'video/x-raw, width=640' ! decodebin ! t. ! appsink"#;
        assert_eq!(names(text), ["filesrc", "decodebin", "appsink"]);
        assert!(names(" ! ( ! x=1").is_empty());
    }

    #[test]
    fn a_misspelt_element_is_found_without_a_pipeline() {
        assert_eq!(unknown_element("videotestsorce num-buffers=2 ! appsink"), Some("videotestsorce"));
        assert_eq!(unknown_element("fakesrc ! queue ! fakesink"), None);
    }
}
