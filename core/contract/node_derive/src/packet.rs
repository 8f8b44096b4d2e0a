//! `#[derive(Packet)]`.

use proc_macro2::TokenStream;
use quote::{ToTokens, quote, quote_spanned};
use syn::{Data, DeriveInput, Error, Fields, LitStr, Result};

pub fn expand(input: &DeriveInput) -> Result<TokenStream> {
    let name = &input.ident;
    let Data::Struct(data) = &input.data else {
        return Err(Error::new_spanned(name, "a packet is a struct of plain data"));
    };
    let Fields::Named(fields) = &data.fields else {
        return Err(Error::new_spanned(name, "a packet has named fields"));
    };
    if !input.generics.params.is_empty() {
        return Err(Error::new_spanned(&input.generics, "a packet has one fixed layout: no generics"));
    }
    let mut repr_c = false;
    let mut packet_name = None;
    for attribute in &input.attrs {
        if attribute.path().is_ident("repr") {
            repr_c |= attribute.to_token_stream().to_string().contains('C');
        }
        if attribute.path().is_ident("packet") {
            attribute.parse_nested_meta(|meta| {
                if meta.path.is_ident("name") {
                    packet_name = Some(meta.value()?.parse::<LitStr>()?);
                    Ok(())
                } else {
                    Err(meta.error("`name` is the only key: `#[packet(name = \"my_type\")]`"))
                }
            })?;
        }
    }
    if !repr_c {
        return Err(Error::new_spanned(
            name,
            "a packet crosses between plugins: its layout must be fixed with `#[repr(C)]`",
        ));
    }
    let Some(packet_name) = packet_name else {
        return Err(Error::new_spanned(name, "a packet needs a name for graph files: `#[packet(name = \"my_type\")]`"));
    };
    let text = packet_name.value();
    let shape = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
    if !text.starts_with(|c: char| c.is_ascii_lowercase()) || !text.chars().all(shape) {
        return Err(Error::new_spanned(
            packet_name,
            format!("`{text}` is no name for a packet: write it in `snake_case`"),
        ));
    }
    let types: Vec<_> = fields.named.iter().map(|f| &f.ty).collect();
    let mut layout = String::new();
    for field in &fields.named {
        let ident = field.ident.as_ref().expect("named fields have names");
        let ty = field.ty.to_token_stream().to_string().replace(' ', "");
        layout.push_str(&format!("{ident}:{ty};"));
    }
    // Padding bytes would make recordings differ from run to run.
    let padding = format!("packet `{name}` has padding between its fields: order them by size or add reserved fields");
    let no_padding = quote_spanned! {name.span()=>
        const _: () = ::core::assert!(
            ::panoscope_node::__private::sum(&[#(::panoscope_node::__private::plain_size::<#types>()),*])
                == ::core::mem::size_of::<#name>(),
            #padding
        );
    };
    Ok(quote! {
        #no_padding
        // SAFETY: repr(C), every field is plain data and there is no padding (asserted above).
        unsafe impl ::panoscope_node::Plain for #name {}
        impl ::panoscope_node::Packet for #name {
            const NAME: &'static str = #packet_name;
            const LAYOUT_HASH: u64 = {
                let hash = ::panoscope_node::abi::fnv1a(::panoscope_node::abi::FNV_START, #layout.as_bytes());
                ::panoscope_node::abi::fnv1a(hash, &(::core::mem::size_of::<#name>() as u64).to_le_bytes())
            };
        }
    })
}
