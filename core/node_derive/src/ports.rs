//! `#[derive(Ports)]`.

use proc_macro2::TokenStream;
use quote::quote;
use syn::{Data, DeriveInput, Error, Fields, GenericParam, Result};

use crate::docs;

pub fn expand(input: &DeriveInput) -> Result<TokenStream> {
    let name = &input.ident;
    let Data::Struct(data) = &input.data else {
        return Err(Error::new_spanned(name, "ports are the fields of a struct"));
    };
    let fields: Vec<_> = match &data.fields {
        Fields::Named(fields) => fields.named.iter().collect(),
        Fields::Unit => Vec::new(),
        Fields::Unnamed(_) => return Err(Error::new_spanned(name, "ports need names: use a struct with named fields")),
    };
    let lifetimes: Vec<_> =
        input.generics.params.iter().filter(|p| matches!(p, GenericParam::Lifetime(_))).cloned().collect();
    if lifetimes.len() > 1 || input.generics.params.len() > lifetimes.len() {
        return Err(Error::new_spanned(&input.generics, "a struct of ports has one lifetime at most: `struct In<'f>`"));
    }
    if !fields.is_empty() && lifetimes.is_empty() {
        return Err(Error::new_spanned(
            name,
            "frames are borrowed for the call: write `struct In<'f>` and `Image<'f, ...>`",
        ));
    }
    let (lifetime, applied) = match lifetimes.first() {
        Some(GenericParam::Lifetime(l)) => {
            let l = &l.lifetime;
            (quote!(#l), quote!(<#l>))
        }
        _ => (quote!('f), quote!()),
    };
    let mut ports = Vec::new();
    let mut binds = Vec::new();
    for (index, field) in fields.iter().enumerate() {
        let ident = field.ident.as_ref().expect("named fields have names");
        let doc = docs::text(&field.attrs);
        if doc.is_empty() {
            return Err(Error::new_spanned(
                ident,
                format!("port `{ident}` needs a doc comment: it is the tooltip that users read"),
            ));
        }
        let ty = &field.ty;
        let port_name = ident.to_string();
        let port_name = port_name.trim_start_matches("r#");
        ports.push(quote! {
            ::panoscope_node::__private::port(#port_name, #doc, <#ty as ::panoscope_node::PortField<#lifetime>>::PORT)
        });
        binds.push(quote! {
            #ident: <#ty as ::panoscope_node::PortField<#lifetime>>::bind(call, #index, #port_name)?
        });
    }
    Ok(quote! {
        impl<#lifetime> ::panoscope_node::Ports<#lifetime> for #name #applied {
            const PORTS: &'static [::panoscope_node::abi::Port] = &[#(#ports),*];
            fn bind(call: ::panoscope_node::RawCall<#lifetime>) -> ::panoscope_node::Result<Self> {
                let _ = call;
                Ok(Self { #(#binds),* })
            }
        }
    })
}
