use panoscope_node::*;

#[derive(Ports)]
struct In<'f> {
    /// Left view.
    left: Image<'f, Gray8>,
}

#[derive(Ports)]
struct Out<'f> {
    /// The same view.
    image: Slot<'f, Gray8>,
}

struct Copy;

impl Node for Copy {
    const INFO: NodeInfo = NodeInfo::compute("copy", "filter", "Hands its input on.");
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = ();

    fn open(_: &Open<'_>, _: &()) -> Result<Self> {
        Ok(Self)
    }

    fn process<'f>(&mut self, _: &Context<'f>, input: In<'f>, mut out: Out<'f>, _: &()) -> Result<()> {
        out.image.forward(input.lfet.frame())
    }
}

fn main() {}
