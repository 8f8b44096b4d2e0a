use panoscope_node::*;

#[derive(Ports)]
struct Views<'f> {
    /// Left view.
    left: Image<'f, Gray8>,
}

#[derive(Ports)]
struct In<'f> {
    /// Another left view.
    left: Image<'f, Gray8>,
    #[ports(flatten)]
    views: Views<'f>,
}

fn main() {}
