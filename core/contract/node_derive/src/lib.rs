//! Derives for ports, parameters and packets of Panoscope nodes.
//!
//! They describe; they never call anything. What they generate names only items of `panoscope_node`.

#![forbid(unsafe_code)]

mod choice;
mod docs;
mod nest;
mod packet;
mod params;
mod ports;

use proc_macro::TokenStream;
use syn::{DeriveInput, parse_macro_input};

fn expanded(result: syn::Result<proc_macro2::TokenStream>) -> TokenStream {
    result.unwrap_or_else(|error| error.to_compile_error()).into()
}

/// Makes a struct whose fields are ports usable as a node's `In` or `Out`.
///
/// Every field needs a doc comment: it is the port's tooltip. A field with `#[ports(flatten)]` is itself a struct of
/// ports; its ports replace the field.
#[proc_macro_derive(Ports, attributes(ports))]
pub fn derive_ports(input: TokenStream) -> TokenStream {
    expanded(ports::expand(&parse_macro_input!(input as DeriveInput)))
}

/// Makes a struct usable as a node's parameters.
///
/// Every field needs a doc comment and `#[param(default = ...)]`; numbers need `range = low..=high`. Optional keys:
/// `step = ...`, `unit = "px"` (which must agree with a name such as `window_px`), `reopen`; for lists `points`,
/// `rectangles`; for texts `file`; for paths `must_exist`, `writes` (the node writes that file) and `shipped` (the
/// default comes with the plugin, in the folder of the plugin's name next to its library). A field with
/// `#[param(flatten)]` is itself a struct of parameters; its parameters replace the field.
#[proc_macro_derive(Params, attributes(param))]
pub fn derive_params(input: TokenStream) -> TokenStream {
    expanded(params::expand(&parse_macro_input!(input as DeriveInput)))
}

/// Makes an enum without fields usable as a parameter; variants are named in `snake_case` in graph files.
#[proc_macro_derive(Choice)]
pub fn derive_choice(input: TokenStream) -> TokenStream {
    expanded(choice::expand(&parse_macro_input!(input as DeriveInput)))
}

/// Makes a `#[repr(C)]`, `Copy` struct of plain data a new packet type: `#[packet(name = "my_type")]`.
#[proc_macro_derive(Packet, attributes(packet))]
pub fn derive_packet(input: TokenStream) -> TokenStream {
    expanded(packet::expand(&parse_macro_input!(input as DeriveInput)))
}
