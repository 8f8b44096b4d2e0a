//! Picture files of several views, put together by the numbers in their names.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Numbers of a name, without zeros in front; what two pictures of one instant share.
type Key = Vec<String>;

/// Files of several views in which entry `i` of every view belongs to one instant.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Matched {
    /// One list per view, all of one length.
    pub views: Vec<Vec<PathBuf>>,
    /// Per view: the files without a partner in every other view.
    pub lonely: Vec<Vec<PathBuf>>,
    /// Whether the names' numbers decided; otherwise the order of the names did.
    pub by_number: bool,
}

fn numbers(path: &Path) -> Key {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let runs = stem.split(|c: char| !c.is_ascii_digit()).filter(|run| !run.is_empty());
    runs.map(|run| run.trim_start_matches('0').to_owned()).collect()
}

/// The numbers in which the files of one view differ. A camera's number or a date is the same in all of them and is left out.
fn keys(files: &[PathBuf]) -> Vec<Key> {
    let mut all: Vec<Key> = files.iter().map(|path| numbers(path)).collect();
    let count = all.first().map_or(0, Vec::len);
    if all.len() < 2 || all.iter().any(|key| key.len() != count) {
        return all;
    }
    let varies: Vec<bool> = (0..count).map(|run| all.iter().any(|key| key[run] != all[0][run])).collect();
    for key in &mut all {
        let mut run = varies.iter();
        key.retain(|_| run.next() == Some(&true));
    }
    all
}

/// Keys of all views, comparable with each other; `None` where a name has no number of its own.
fn comparable(views: &[Vec<PathBuf>]) -> Option<Vec<Vec<Key>>> {
    let mut all: Vec<Vec<Key>> = views.iter().map(|files| keys(files)).collect();
    // `cam0_12` beside `12`: the last numbers count.
    let shortest = all.iter().flatten().map(Vec::len).min().filter(|len| *len > 0)?;
    for key in all.iter_mut().flatten() {
        key.drain(..key.len() - shortest);
    }
    let unique = |keys: &Vec<Key>| keys.iter().collect::<BTreeSet<_>>().len() == keys.len();
    all.iter().all(unique).then_some(all)
}

/// The first two files, in the order of their numbers, between which numbers are missing. `None` if all follow each other or are not numbered.
pub fn gap(files: &[PathBuf]) -> Option<[&Path; 2]> {
    let number = |key: &Key| match key.as_slice() {
        [one] => {
            if one.is_empty() {
                Some(0)
            } else {
                one.parse::<u64>().ok()
            }
        }
        _ => None,
    };
    let numbers: Vec<u64> = keys(files).iter().map(number).collect::<Option<_>>()?;
    let index = numbers.windows(2).position(|pair| pair[1] > pair[0] + 1)?;
    Some([&files[index], &files[index + 1]])
}

/// Groups the pictures that carry the same number. Where numbers are missing, repeat or are never the same in all views, the order
/// of the lists decides.
pub fn matched(views: &[Vec<PathBuf>]) -> Matched {
    let by_number = comparable(views).and_then(|keys| {
        let sets: Vec<BTreeSet<&Key>> = keys.iter().map(|keys| keys.iter().collect()).collect();
        let (first, others) = sets.split_first()?;
        let shared: BTreeSet<&Key> =
            first.iter().copied().filter(|key| others.iter().all(|set| set.contains(*key))).collect();
        if shared.is_empty() {
            return None;
        }
        let mut found = Matched { by_number: true, ..Matched::default() };
        for (files, own) in views.iter().zip(&keys) {
            let by_key: BTreeMap<&Key, &PathBuf> = own.iter().zip(files).collect();
            // In the order of the first view, so that entries belong together whatever the names' letters are.
            let order = keys[0].iter().filter(|key| shared.contains(*key));
            found.views.push(order.filter_map(|key| by_key.get(key).map(|path| (*path).clone())).collect());
            let lonely = own.iter().zip(files).filter(|(key, _)| !shared.contains(*key));
            found.lonely.push(lonely.map(|(_, path)| path.clone()).collect());
        }
        Some(found)
    });
    by_number.unwrap_or_else(|| {
        let count = views.iter().map(Vec::len).min().unwrap_or(0);
        let (views, lonely) = views.iter().map(|files| (files[..count].to_vec(), files[count..].to_vec())).unzip();
        Matched { views, lonely, by_number: false }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn files(names: &[&str]) -> Vec<PathBuf> {
        names.iter().map(PathBuf::from).collect()
    }

    fn both(left: &[&str], right: &[&str]) -> Matched {
        matched(&[files(left), files(right)])
    }

    #[test]
    fn pictures_are_paired_by_their_numbers() {
        let found = both(&["l01.png", "l02.png", "l04.png"], &["r1.png", "r3.png", "r4.png"]);
        assert_eq!(found.views, [files(&["l01.png", "l04.png"]), files(&["r1.png", "r4.png"])]);
        assert_eq!(found.lonely, [files(&["l02.png"]), files(&["r3.png"])]);
        assert!(found.by_number);
    }

    #[test]
    fn numbers_that_are_the_same_in_a_whole_view_do_not_count() {
        // A camera's number in front, behind, and a date.
        for (left, right) in [
            (["cam0_1.png", "cam0_2.png", "cam0_4.png"], ["cam1_2.png", "cam1_3.png", "cam1_4.png"]),
            (["1_cam0.png", "2_cam0.png", "4_cam0.png"], ["2_cam1.png", "3_cam1.png", "4_cam1.png"]),
            (["20260101_1_l.png", "20260101_2_l.png", "20260101_4_l.png"], ["7_2.png", "7_3.png", "7_4.png"]),
        ] {
            let found = both(&left, &right);
            assert_eq!(found.views, [files(&left[1..]), files(&[right[0], right[2]])], "{left:?}");
            assert_eq!(found.lonely, [files(&left[..1]), files(&right[1..2])]);
        }
        let found = both(&["cam0_0003.png"], &["cam1_0001.png", "cam1_0003.png"]);
        assert_eq!(found.views, [files(&["cam0_0003.png"]), files(&["cam1_0003.png"])]);
    }

    #[test]
    fn names_without_common_numbers_are_paired_in_order() {
        let found = both(&["a.png", "b.png"], &["c.png"]);
        assert_eq!(found.views, [files(&["a.png"]), files(&["c.png"])]);
        assert_eq!(found.lonely, [files(&["b.png"]), files(&[])]);
        assert!(!found.by_number);
        let found = both(&["l10.png", "l11.png"], &["r20.png", "r21.png"]);
        assert_eq!(found.views, [files(&["l10.png", "l11.png"]), files(&["r20.png", "r21.png"])]);
    }

    #[test]
    fn missing_numbers_are_found() {
        let none = |names: &[&str]| assert_eq!(gap(&files(names)), None, "{names:?}");
        none(&["d_9.pfm", "d_10.pfm", "d_11.pfm"]);
        none(&["000000_10.png", "000001_10.png"]);
        none(&["a.png", "c.png"]);
        none(&["d_7.pfm"]);
        let names = files(&["d_000.pfm", "d_001.pfm", "d_003.pfm"]);
        assert_eq!(gap(&names), Some([names[1].as_path(), names[2].as_path()]));
    }

    #[test]
    fn four_views_share_what_all_of_them_have() {
        let views = [&["a1", "a2", "a3"][..], &["b2", "b3"], &["c1", "c3", "c2"], &["d3", "d2", "d9"]].map(files);
        let found = matched(&views);
        assert_eq!(found.views, [["a2", "a3"], ["b2", "b3"], ["c2", "c3"], ["d2", "d3"]].map(|v| files(&v)));
        assert_eq!(found.lonely, [&["a1"][..], &[], &["c1"], &["d9"]].map(files));
    }
}
