//! The model of a graph that the checks compare a run with.

use panoscope_sim::content::name_hash;
use panoscope_sim::graphs::{Kind, Model, Node, harm_name};
use panoscope_sim::harm::Harm;

#[test]
fn names_of_harms_are_those_of_graph_files() {
    assert_eq!(harm_name(Harm::HangInNestedLoop), "hang_in_nested_loop");
    assert_eq!(harm_name(Harm::Nan), "nan");
}

#[test]
fn a_graph_knows_its_ways() {
    let nodes = vec![
        Node::new("a", Kind::Camera, &[]),
        Node::new("b", Kind::Pass, &["a"]),
        Node::new("c", Kind::Mark, &["b"]),
        Node::new("d", Kind::Pair, &["c", "a"]),
        Node::new("e", Kind::Write, &["d"]),
    ];
    let model = Model { batch: false, nodes };
    assert_eq!(model.steps_out_of("d"), ["a", "c", "d"].map(name_hash));
    assert_eq!(model.source_of("e"), Some("a"));
    assert!(model.is_healthy("e") && model.upstream("e").len() == 5);
}
