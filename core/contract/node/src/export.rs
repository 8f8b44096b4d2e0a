//! Turns a [`Node`] into the ABI's descriptor and functions.

use std::ffi::c_void;
use std::marker::PhantomData;

use crate::abi::{self, Str};
use crate::context::{Context, Finish, Open};
use crate::error::NodeError;
use crate::guard;
pub use crate::guard::install_panic_hook;
use crate::param::Params;
use crate::port::{Ports, RawCall};
use crate::validation::{Problem, Validation, refuse_invalid};
use crate::{Kind, Node};

struct Instance<N: Node> {
    node: N,
    params: N::Params,
    params_version: u64,
}

/// Holder of the ABI descriptor of node type `N`.
pub struct NodeTypeOf<N>(PhantomData<N>);

impl<N: Node> NodeTypeOf<N> {
    /// The descriptor, with functions that call `N` and stop its panics.
    pub const NODE_TYPE: abi::NodeType = abi::NodeType {
        struct_size: size_of::<abi::NodeType>() as u32,
        kind: match N::INFO.kind {
            Kind::Compute => abi::KIND_COMPUTE,
            Kind::Blocking => abi::KIND_BLOCKING,
            Kind::Realtime => abi::KIND_REALTIME,
        },
        flags: if N::INFO.source { abi::NODE_SOURCE } else { 0 }
            | if N::INFO.exclusive { abi::NODE_EXCLUSIVE } else { 0 }
            | if N::INFO.side_effects { abi::NODE_SIDE_EFFECTS } else { 0 }
            // The types of this crate fetch what they read.
            | abi::NODE_FETCHES,
        reserved: 0,
        name: Str::new(N::INFO.name),
        family: Str::new(N::INFO.family),
        doc: Str::new(N::INFO.doc),
        inputs: <N::In<'static> as Ports<'static>>::PORTS.as_ptr(),
        inputs_len: <N::In<'static> as Ports<'static>>::PORTS.len(),
        outputs: <N::Out<'static> as Ports<'static>>::PORTS.as_ptr(),
        outputs_len: <N::Out<'static> as Ports<'static>>::PORTS.len(),
        params: <N::Params as Params>::PARAMS.as_ptr(),
        params_len: <N::Params as Params>::PARAMS.len(),
        open: Some(open::<N>),
        process: Some(process::<N>),
        close: Some(close::<N>),
        save_state: Some(save_state::<N>),
        load_state: Some(load_state::<N>),
        validate: Some(validate::<N>),
        finish: Some(finish::<N>),
    };
}

unsafe fn values<'a>(params: *const abi::ParamValue, len: usize) -> &'a [abi::ParamValue] {
    // SAFETY: the host keeps `len` values readable at `params` for the length of the call.
    if len == 0 { &[] } else { unsafe { std::slice::from_raw_parts(params, len) } }
}

unsafe fn fail(host: *const abi::Host, call: *mut c_void, message: &str) {
    // SAFETY: the host's table and handle are valid for the length of the call.
    unsafe {
        if let Some(fail) = (*host).fail {
            fail(call, Str::borrow(message));
        }
    }
}

/// Runs the body of an ABI function; an error or a panic becomes a message to the host and a status.
unsafe fn guarded(
    host: *const abi::Host,
    call: *mut c_void,
    body: impl FnOnce() -> Result<abi::Status, NodeError>,
) -> abi::Status {
    match guard::catch(body) {
        Ok(Ok(status)) => status,
        Ok(Err(error)) => {
            // SAFETY: the caller passes the host's table and handle of the running call, both valid until it returns.
            unsafe { fail(host, call, error.message()) };
            error.status()
        }
        Err(caught) => {
            // SAFETY: the caller passes the host's table and handle of the running call, both valid until it returns.
            unsafe { fail(host, call, &caught.text()) };
            caught.discard();
            abi::STATUS_PANIC
        }
    }
}

unsafe extern "C" fn open<N: Node>(open: *mut abi::OpenCall, instance: *mut *mut c_void) -> abi::Status {
    // SAFETY: the host keeps the call valid until this function returns.
    let (host, call) = unsafe { ((*open).host, (*open).call) };
    // SAFETY: the host keeps the call, its values and its texts valid until this function returns, and `instance` is writable.
    unsafe {
        guarded(host, call, || {
            let params = N::Params::read(values((*open).params, (*open).params_len))?;
            let opening = Open::new(open);
            refuse_invalid::<N>(opening.node_id(), opening.graph_dir(), (*open).flags, &params)?;
            let node = N::open(&opening, &params)?;
            let boxed = Box::new(Instance { node, params, params_version: u64::MAX });
            *instance = Box::into_raw(boxed).cast();
            Ok(abi::STATUS_OK)
        })
    }
}

unsafe extern "C" fn validate<N: Node>(call: *mut abi::ValidateCall) -> abi::Status {
    // SAFETY: the host keeps the call valid until this function returns and does not write to it meanwhile.
    let call = unsafe { &*call };
    let report = |severity: u32, param: u32, message: &str, help: &str| {
        if let Some(invalid) = call.invalid {
            // SAFETY: the handle of the running call; texts are borrowed for the length of the function.
            unsafe { invalid(call.call, severity, param, Str::borrow(message), Str::borrow(help)) }
        }
    };
    let checked = guard::catch(|| {
        // SAFETY: texts and values of the call are valid for its length.
        let (node_id, graph_dir, values) = unsafe {
            (
                call.node_id.text().unwrap_or(""),
                call.graph_dir.text().unwrap_or(""),
                values(call.params, call.params_len),
            )
        };
        let mut forward = |p: Problem<'_>| report(p.severity, p.param, p.message, p.help);
        let counts = match call.connections_len {
            0 => &[],
            // SAFETY: the host's counts are readable for the length of the call.
            len => unsafe { std::slice::from_raw_parts(call.connections, len) },
        };
        let wiring = (call.flags & abi::CALL_WIRED != 0).then_some((counts, call.outputs_read));
        let params = N::Params::read(values)?;
        let mut check = Validation::new::<N>(node_id, graph_dir.as_ref(), call.flags, wiring, &mut forward);
        N::validate(&params, &mut check);
        Ok::<(), NodeError>(())
    });
    match checked {
        Ok(Ok(())) => abi::STATUS_OK,
        Ok(Err(error)) => {
            report(abi::PROBLEM_ERROR, abi::NO_PARAM, error.message(), "");
            error.status()
        }
        Err(caught) => {
            let message = format!("its parameter check {}", caught.text());
            report(abi::PROBLEM_ERROR, abi::NO_PARAM, &message, "this is a bug in the plugin");
            caught.discard();
            abi::STATUS_PANIC
        }
    }
}

unsafe extern "C" fn process<N: Node>(instance: *mut c_void, call: *mut abi::Call) -> abi::Status {
    // SAFETY: the host keeps the call valid until this function returns, and passes an instance from `open` to one thread at a time.
    unsafe {
        let (host, handle) = ((*call).host, (*call).call);
        let this = &mut *instance.cast::<Instance<N>>();
        guarded(host, handle, || {
            if this.params_version != (*call).params_version {
                this.params = N::Params::read(values((*call).params, (*call).params_len))?;
                this.params_version = (*call).params_version;
            }
            let raw = RawCall::new(call);
            let input = <N::In<'_> as Ports<'_>>::bind(raw, 0)?;
            let out = <N::Out<'_> as Ports<'_>>::bind(raw, 0)?;
            let context = Context::new(raw);
            this.node.process(&context, input, out, &this.params)?;
            Ok(if context.ended() { abi::STATUS_END } else { abi::STATUS_OK })
        })
    }
}

unsafe extern "C" fn finish<N: Node>(instance: *mut c_void, host: *const abi::Host, call: *mut c_void) -> abi::Status {
    // SAFETY: the host passes an instance from `open` to one thread at a time, and keeps its table and handle valid for the call.
    unsafe {
        let this = &mut *instance.cast::<Instance<N>>();
        guarded(host, call, || {
            this.node.finish(&Finish::new(&*host, call))?;
            Ok(abi::STATUS_OK)
        })
    }
}

unsafe extern "C" fn close<N: Node>(instance: *mut c_void) {
    // SAFETY: the host passes an instance that `open` boxed, once, and does not use it afterwards.
    let boxed = unsafe { Box::from_raw(instance.cast::<Instance<N>>()) };
    if let Err(caught) = guard::catch(move || drop(boxed)) {
        caught.discard();
    }
}

unsafe extern "C" fn save_state<N: Node>(
    instance: *mut c_void,
    host: *const abi::Host,
    sink: *mut c_void,
) -> abi::Status {
    // SAFETY: the host passes an instance from `open` to one thread at a time, and keeps its table valid.
    unsafe {
        let this = &*instance.cast::<Instance<N>>();
        match guard::catch(|| this.node.save_state()) {
            Ok(Some(bytes)) => {
                if let Some(save) = (*host).save {
                    save(sink, bytes.as_ptr(), bytes.len());
                }
                abi::STATUS_OK
            }
            Ok(None) => abi::STATUS_OK,
            Err(caught) => {
                caught.discard();
                abi::STATUS_PANIC
            }
        }
    }
}

unsafe extern "C" fn load_state<N: Node>(instance: *mut c_void, bytes: *const u8, len: usize) -> abi::Status {
    // SAFETY: the host passes an instance from `open` to one thread at a time, and `len` readable bytes.
    unsafe {
        let this = &mut *instance.cast::<Instance<N>>();
        let bytes = if len == 0 { &[] } else { std::slice::from_raw_parts(bytes, len) };
        match guard::catch(|| this.node.load_state(bytes)) {
            Ok(Ok(())) => abi::STATUS_OK,
            Ok(Err(_)) => abi::STATUS_ERROR,
            Err(caught) => {
                caught.discard();
                abi::STATUS_PANIC
            }
        }
    }
}

/// Stores the host's function table and installs the panic hook. The host calls it once after loading the plugin.
///
/// # Safety
/// `host` is the host's function table and stays valid until the process ends.
pub unsafe extern "C" fn attach(host: *const abi::Host) -> abi::Status {
    // SAFETY: the caller guarantees that the table stays valid until the process ends.
    unsafe { crate::host::attach(host) };
    install_panic_hook();
    abi::STATUS_OK
}

/// Makes this crate a plugin with the given nodes. Use it once per cdylib.
///
/// The plugin is named after its crate without a leading `panoscope-`, or explicitly: `export_plugin!["my_name"; A,
/// B]`. Without the crate's default feature `plugin` the entry symbol is not exported, so that tests can link several
/// plugins into one binary.
#[macro_export]
macro_rules! export_plugin {
    ($($node:ty),+ $(,)?) => {
        $crate::export_plugin![$crate::export::plugin_name(env!("CARGO_PKG_NAME")); $($node),+];
    };
    ($name:expr; $($node:ty),+ $(,)?) => {
        /// The plugin's descriptor.
        pub static PANOSCOPE_PLUGIN: $crate::abi::Plugin = {
            #[used]
            #[unsafe(link_section = ".note.panoscope")]
            static NOTE: $crate::abi::Note = $crate::abi::Note::new(
                $name,
                env!("CARGO_PKG_VERSION"),
                &[$(<$node as $crate::Node>::INFO.name),+],
            );
            static TYPES: $crate::export::NodeTypes<{ [$(stringify!($node)),+].len() }> =
                $crate::export::NodeTypes([$(&$crate::export::NodeTypeOf::<$node>::NODE_TYPE),+]);
            $crate::abi::Plugin {
                magic: $crate::abi::MAGIC,
                abi_major: $crate::abi::ABI_MAJOR,
                abi_minor: $crate::abi::ABI_MINOR,
                struct_size: ::core::mem::size_of::<$crate::abi::Plugin>() as u32,
                reserved: 0,
                name: $crate::abi::Str::new($name),
                version: $crate::abi::Str::new(env!("CARGO_PKG_VERSION")),
                doc: $crate::abi::Str::new(env!("CARGO_PKG_DESCRIPTION")),
                node_types: TYPES.0.as_ptr().cast(),
                node_types_len: TYPES.0.len(),
                note: &NOTE,
                attach: Some($crate::export::attach),
            }
        };

        /// Returns the plugin's descriptor.
        #[cfg(feature = "plugin")]
        #[unsafe(no_mangle)]
        pub extern "C" fn panoscope_plugin() -> *const $crate::abi::Plugin {
            &raw const PANOSCOPE_PLUGIN
        }
    };
}

/// Pointers to the descriptors of a plugin's `N` node types.
pub struct NodeTypes<const N: usize>(pub [&'static abi::NodeType; N]);

/// The plugin name of a package: `panoscope-stitch` becomes `stitch`.
pub const fn plugin_name(package: &'static str) -> &'static str {
    let prefix = b"panoscope-";
    let bytes = package.as_bytes();
    let mut i = 0;
    while i < prefix.len() {
        if i >= bytes.len() || bytes[i] != prefix[i] {
            return package;
        }
        i += 1;
    }
    package.split_at(prefix.len()).1
}
