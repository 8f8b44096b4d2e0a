use panoscope_node::*;

#[derive(Ports)]
struct Views<'f> {
    /// Left view.
    left: Image<'f, Gray8>,
}

#[derive(Ports)]
struct In<'f> {
    #[ports(nested)]
    views: Views<'f>,
}

fn main() {}
