use panoscope_node::*;
#[derive(Ports)]
pub struct In<'f> {
    /// Any picture.
    image: Image<'f, Gray8>,
}
#[derive(Ports)]
pub struct Out<'f> {
    /// Its negative.
    image: Slot<'f, Gray8>,
}
pub struct Negative;
impl Node for Negative {
    const INFO: NodeInfo = NodeInfo::compute("negative", "filter", "Dark becomes bright.");
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = ();
    fn open(_: &Open<'_>, _: &()) -> Result<Self> {
        Ok(Self)
    }
    fn process<'f>(&mut self, _: &Context<'f>, input: In<'f>, mut out: Out<'f>, _: &()) -> Result<()> {
        let image = input.image.view();
        let mut negative = out.image.alloc(image.width, image.height)?;
        for y in 0..image.height {
            negative.row_mut(y).iter_mut().zip(image.row(y)).for_each(|(to, from)| *to = 255 - from);
        }
        Ok(())
    }
}
export_plugin![Negative];
