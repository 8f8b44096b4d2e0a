//! `#[derive(Ports)]`.

use proc_macro2::TokenStream;
use quote::{ToTokens, quote, quote_spanned};
use syn::spanned::Spanned;
use syn::{Data, DeriveInput, Error, Field, Fields, GenericParam, Result, Type};

use crate::docs;
use crate::nest::{Declarations, with_static};

/// Whether a field is a flattened struct of ports.
fn is_flattened(field: &Field) -> Result<bool> {
    let mut flattened = false;
    for attribute in field.attrs.iter().filter(|a| a.path().is_ident("ports")) {
        attribute.parse_nested_meta(|meta| {
            if meta.path.is_ident("flatten") {
                flattened = true;
                Ok(())
            } else {
                Err(meta.error("`flatten` is the only key: `#[ports(flatten)]`"))
            }
        })?;
    }
    Ok(flattened)
}

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
    let owner = lifetimes.first().map(|p| p.to_token_stream().to_string()).unwrap_or_default();
    let owner = owner.trim_start_matches('\'');
    let mut declared = Declarations::of_ports(owner);
    let mut binds = Vec::new();
    for field in fields {
        let ident = field.ident.as_ref().expect("named fields have names");
        let ty = &field.ty;
        let index = declared.next_index();
        if is_flattened(field)? {
            let nested = quote_spanned!(ty.span()=> <#ty as ::panoscope_node::Ports<#lifetime>>);
            binds.push(quote! { #ident: #nested::bind(call, first + #index)? });
            let static_ty: Type = syn::parse2(with_static(ty.to_token_stream(), owner))?;
            declared.nested(&static_ty);
            continue;
        }
        let doc = docs::text(&field.attrs);
        if doc.is_empty() {
            return Err(Error::new_spanned(
                ident,
                format!("port `{ident}` needs a doc comment: it is the tooltip that users read"),
            ));
        }
        let port_name = ident.to_string();
        let port_name = port_name.trim_start_matches("r#");
        let declaration = quote! {
            ::panoscope_node::__private::port(
                #port_name,
                #doc,
                <#ty as ::panoscope_node::PortField<#lifetime>>::PORT
            )
        };
        declared.own(port_name, ident, declaration);
        binds.push(quote! {
            #ident: <#ty as ::panoscope_node::PortField<#lifetime>>::bind(call, first + #index, #port_name)?
        });
    }
    let (unique, list) = declared.finish();
    Ok(quote! {
        #unique
        impl<#lifetime> ::panoscope_node::Ports<#lifetime> for #name #applied {
            const PORTS: &'static [::panoscope_node::abi::Port] = #list;
            fn bind(call: ::panoscope_node::RawCall<#lifetime>, first: usize) -> ::panoscope_node::Result<Self> {
                let _ = (call, first);
                Ok(Self { #(#binds),* })
            }
        }
    })
}
