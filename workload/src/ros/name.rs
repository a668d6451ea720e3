//! Names of nodes, topics and parameters. Source: <http://wiki.ros.org/Names>.

/// The longest name that is taken from anybody.
const LONGEST: usize = 255;

/// Whether this is a full name of a node or topic: a slash, then parts of letters, digits and `_`.
pub(super) fn is_global(name: &str) -> bool {
    name.len() <= LONGEST
        && name
            .strip_prefix('/')
            .is_some_and(|rest| rest.split('/').all(is_part))
}

fn is_part(part: &str) -> bool {
    let starts_well = part.starts_with(|first: char| first.is_ascii_alphabetic() || first == '_');
    starts_well
        && part
            .bytes()
            .all(|byte| byte.is_ascii_alphanumeric() || byte == b'_')
}

/// The full name that `name` means when `caller` says it, with the slashes it needs and no more: `~a` is private to
/// the caller, `a` is in the caller's namespace, `/a` is global.
pub(super) fn resolve(name: &str, caller: &str) -> String {
    if let Some(private) = name.strip_prefix('~') {
        return canonical(&format!("{caller}/{private}"));
    }
    if name.starts_with('/') {
        return canonical(name);
    }
    let namespace = caller
        .trim_end_matches('/')
        .rsplit_once('/')
        .map_or("", |(namespace, _)| namespace);
    canonical(&format!("{namespace}/{name}"))
}

/// With one slash before each part and none at the end.
pub(super) fn canonical(name: &str) -> String {
    format!("/{}", parts(name).collect::<Vec<_>>().join("/"))
}

/// The parts between the slashes.
pub(super) fn parts(name: &str) -> impl DoubleEndedIterator<Item = &str> {
    name.split('/').filter(|part| !part.is_empty())
}

/// Whether `name` is `space` or lies within it; both canonical.
pub(super) fn is_within(name: &str, space: &str) -> bool {
    let space = space.trim_end_matches('/');
    name.strip_prefix(space)
        .is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[rstest::rstest]
    #[case("rate", "/robot/controller", "/robot/rate")]
    #[case("rate", "/controller", "/rate")]
    #[case("~rate", "/robot/controller", "/robot/controller/rate")]
    #[case("//a//b/", "/controller", "/a/b")]
    #[case("/", "/controller", "/")]
    fn a_name_is_resolved_for_its_caller(#[case] name: &str, #[case] caller: &str, #[case] full: &str) {
        assert_eq!(resolve(name, caller), full);
    }

    #[rstest::rstest]
    #[case("/plant/state_2", true)]
    #[case("/_private", true)]
    #[case("plant", false)]
    #[case("/", false)]
    #[case("/plant/", false)]
    #[case("/2plant", false)]
    #[case("/pl ant", false)]
    fn only_full_names_are_global(#[case] name: &str, #[case] global: bool) {
        assert_eq!(is_global(name), global);
    }

    #[rstest::rstest]
    #[case("/a/b", "/a", true)]
    #[case("/a", "/a", true)]
    #[case("/ab", "/a", false)]
    #[case("/a", "/", true)]
    fn a_name_is_within_its_namespaces(#[case] name: &str, #[case] space: &str, #[case] within: bool) {
        assert_eq!(is_within(name, space), within);
    }
}
