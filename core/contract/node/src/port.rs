//! Ports: how the fields of a node's `In` and `Out` are bound to frames.

use std::marker::PhantomData;

use crate::abi;
use crate::error::Result;

/// The running call as the host describes it.
#[derive(Clone, Copy)]
pub struct RawCall<'f> {
    call: *mut abi::Call,
    lifetime: PhantomData<&'f abi::Call>,
}

impl<'f> RawCall<'f> {
    /// Wraps the host's call.
    ///
    /// # Safety
    /// `call` and everything it points to is valid for `'f`.
    pub(crate) unsafe fn new(call: *mut abi::Call) -> Self {
        Self { call, lifetime: PhantomData }
    }

    /// The host's call.
    pub(crate) fn raw(self) -> *mut abi::Call {
        self.call
    }

    /// The frames of input port `index`; empty when the host knows fewer ports.
    #[inline]
    pub(crate) fn input(self, index: usize) -> &'f [abi::Frame] {
        // SAFETY: the host keeps `inputs` and `input_ranges` valid for the length of the call; the range is checked against their lengths.
        unsafe {
            let call = &*self.call;
            if index >= call.input_ranges_len {
                return &[];
            }
            let range = *call.input_ranges.add(index);
            if range.count == 0 || range.first as usize + range.count as usize > call.inputs_len {
                return &[];
            }
            std::slice::from_raw_parts(call.inputs.add(range.first as usize), range.count as usize)
        }
    }

    /// A copy of the frame of output `index`; empty when the host knows fewer ports.
    pub(crate) fn output(self, index: u32) -> abi::Frame {
        // SAFETY: the host keeps `outputs` valid for the length of the call; the frame is copied without making a reference.
        unsafe {
            let call = self.call;
            if index as usize >= (*call).outputs_len { abi::Frame::EMPTY } else { *(*call).outputs.add(index as usize) }
        }
    }
}

/// A struct of ports; implemented by `#[derive(Ports)]`.
#[diagnostic::on_unimplemented(
    message = "`{Self}` is not a struct of ports",
    label = "not a struct of ports",
    note = "write `#[derive(Ports)]` above it; `#[ports(flatten)]` takes such a struct, not a port"
)]
pub trait Ports<'f>: Sized {
    /// The declarations, in order.
    const PORTS: &'static [abi::Port];

    /// Finds every field's frames. `first` is the index of the struct's first port: above 0 where it is flattened into
    /// another.
    ///
    /// # Errors
    /// A frame that does not fit its port, or none where one is required.
    fn bind(call: RawCall<'f>, first: usize) -> Result<Self>;
}

/// For nodes without inputs or without outputs.
#[derive(Clone, Copy, Debug)]
pub struct NoPorts;

impl<'f> Ports<'f> for NoPorts {
    const PORTS: &'static [abi::Port] = &[];

    fn bind(_: RawCall<'f>, _: usize) -> Result<Self> {
        Ok(Self)
    }
}

/// A type that a port's field may have.
#[diagnostic::on_unimplemented(
    message = "`{Self}` is not a port type",
    label = "not a port",
    note = "inputs are `Image<'f, Gray8>`, `AnyImage<'f>`, `Picture<'f>`, `Value<'f, T>`, `Text<'f>`, `Table<'f>`, `Cloud<'f>`, `Detections<'f>`, `Instances<'f>`, in `Option<...>` or `List<'f, ...>` if wanted; outputs are `Slot<'f, T>`"
)]
pub trait PortField<'f>: Sized {
    /// Port declaration without name and doc.
    const PORT: abi::Port;

    /// Binds the frames of port `index`; `name` is for error messages.
    fn bind(call: RawCall<'f>, index: usize, name: &'static str) -> Result<Self>;
}

/// A port declaration without name and doc.
pub(crate) const fn nameless(packet: &'static str, layout_hash: u64, formats: u32, flags: u32) -> abi::Port {
    abi::Port {
        name: abi::Str::EMPTY,
        doc: abi::Str::EMPTY,
        packet: abi::Str::new(packet),
        layout_hash,
        formats,
        flags,
    }
}

/// Gives a declaration its name and doc; called by the derive.
pub const fn port(name: &'static str, doc: &'static str, port: abi::Port) -> abi::Port {
    abi::Port { name: abi::Str::new(name), doc: abi::Str::new(doc), ..port }
}
