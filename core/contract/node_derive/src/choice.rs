//! `#[derive(Choice)]`.

use proc_macro2::TokenStream;
use quote::quote;
use syn::{Data, DeriveInput, Error, Fields, Result};

use crate::docs;

fn snake_case(name: &str) -> String {
    let mut out = String::new();
    for (i, c) in name.chars().enumerate() {
        if c.is_uppercase() && i > 0 {
            out.push('_');
        }
        out.extend(c.to_lowercase());
    }
    out
}

pub fn expand(input: &DeriveInput) -> Result<TokenStream> {
    let name = &input.ident;
    let Data::Enum(data) = &input.data else {
        return Err(Error::new_spanned(name, "a choice is an enum"));
    };
    let mut words = Vec::new();
    let mut idents = Vec::new();
    for variant in &data.variants {
        if !matches!(variant.fields, Fields::Unit) {
            return Err(Error::new_spanned(&variant.fields, "a choice has no fields"));
        }
        if docs::text(&variant.attrs).is_empty() {
            return Err(Error::new_spanned(&variant.ident, format!("choice `{}` needs a doc comment", variant.ident)));
        }
        words.push(snake_case(&variant.ident.to_string()));
        idents.push(&variant.ident);
    }
    if words.is_empty() {
        return Err(Error::new_spanned(name, "a choice has at least one variant"));
    }
    let words_text = format!("the default is none of the choices: {}", words.join(", "));
    let indices = 0..words.len() as u32;
    Ok(quote! {
        impl ::panoscope_node::Choice for #name {
            const WORDS: &'static [::panoscope_node::abi::Str] = &[#(::panoscope_node::abi::Str::new(#words)),*];
            const WORDS_TEXT: &'static str = #words_text;
            fn from_index(index: u32) -> Option<Self> {
                match index {
                    #(#indices => Some(Self::#idents),)*
                    _ => None,
                }
            }
        }
        ::panoscope_node::choice_param_field!(#name);
    })
}
