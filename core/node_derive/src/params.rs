//! `#[derive(Params)]`.

use proc_macro2::TokenStream;
use quote::quote;
use syn::parse::{Parse, ParseStream};
use syn::{Data, DeriveInput, Error, Expr, ExprLit, ExprRange, Fields, Ident, Lit, LitStr, RangeLimits, Result, Token};

use crate::docs;

/// Units that graph files, tooltips and plots share.
const UNITS: &[&str] = &[
    "px",
    "px/s",
    "mm",
    "mm/s",
    "mm/s2",
    "m",
    "ms",
    "s",
    "us",
    "ns",
    "Hz",
    "1/s",
    "rad",
    "rad/s",
    "deg",
    "deg/s",
    "%",
    "dB",
    "frames",
    "points",
    "bytes",
    "MiB",
    "threads",
    "levels",
    "iterations",
    "ratio",
    "K",
    "pixels",
];

#[derive(Default)]
struct Attribute {
    default: Option<Expr>,
    range: Option<ExprRange>,
    step: Option<Expr>,
    unit: Option<LitStr>,
    reopen: bool,
    must_exist: bool,
}

impl Parse for Attribute {
    fn parse(input: ParseStream) -> Result<Self> {
        let mut out = Attribute::default();
        while !input.is_empty() {
            let key: Ident = input.parse()?;
            match key.to_string().as_str() {
                "reopen" => out.reopen = true,
                "must_exist" => out.must_exist = true,
                "default" | "range" | "step" | "unit" => {
                    input.parse::<Token![=]>()?;
                    match key.to_string().as_str() {
                        "default" => out.default = Some(input.parse()?),
                        "step" => out.step = Some(input.parse()?),
                        "unit" => out.unit = Some(input.parse()?),
                        _ => match input.parse::<Expr>()? {
                            Expr::Range(range) if matches!(range.limits, RangeLimits::Closed(_)) => {
                                out.range = Some(range)
                            }
                            other => {
                                return Err(Error::new_spanned(
                                    other,
                                    "a range includes both ends: write `range = 16..=256`",
                                ));
                            }
                        },
                    }
                }
                other => {
                    return Err(Error::new(
                        key.span(),
                        format!("`{other}` is none of: default, range, step, unit, reopen, must_exist"),
                    ));
                }
            }
            if !input.is_empty() {
                input.parse::<Token![,]>()?;
            }
        }
        Ok(out)
    }
}

/// Which kind of default was written is seen from the literal; whether it fits the field is asserted at compile time.
fn default_value(default: &Expr) -> TokenStream {
    match default {
        Expr::Lit(ExprLit { lit: Lit::Str(text), .. }) => {
            quote!(::panoscope_node::__private::DefaultValue::Text(#text))
        }
        Expr::Lit(ExprLit { lit: Lit::Bool(flag), .. }) => {
            quote!(::panoscope_node::__private::DefaultValue::Flag(#flag))
        }
        Expr::Array(list) => {
            let numbers = list.elems.iter();
            quote!(::panoscope_node::__private::DefaultValue::Floats(&[#((#numbers) as f64),*]))
        }
        number => quote!(::panoscope_node::__private::DefaultValue::Number((#number) as f64)),
    }
}

pub fn expand(input: &DeriveInput) -> Result<TokenStream> {
    let name = &input.ident;
    let Data::Struct(data) = &input.data else {
        return Err(Error::new_spanned(name, "parameters are the fields of a struct"));
    };
    let fields: Vec<_> = match &data.fields {
        Fields::Named(fields) => fields.named.iter().collect(),
        Fields::Unit => Vec::new(),
        Fields::Unnamed(_) => {
            return Err(Error::new_spanned(name, "parameters need names: use a struct with named fields"));
        }
    };
    let mut params = Vec::new();
    let mut reads = Vec::new();
    for (index, field) in fields.iter().enumerate() {
        let ident = field.ident.as_ref().expect("named fields have names");
        let doc = docs::text(&field.attrs);
        if doc.is_empty() {
            return Err(Error::new_spanned(
                ident,
                format!("parameter `{ident}` needs a doc comment: it is the tooltip that users read"),
            ));
        }
        let Some(attribute) = field.attrs.iter().find(|a| a.path().is_ident("param")) else {
            return Err(Error::new_spanned(ident, format!("parameter `{ident}` needs `#[param(default = ...)]`")));
        };
        let attribute: Attribute = attribute.parse_args()?;
        let ty = &field.ty;
        let param_name = ident.to_string();
        let param_name = param_name.trim_start_matches("r#");
        let Some(default) = &attribute.default else {
            return Err(Error::new_spanned(ident, format!("parameter `{ident}` needs a default")));
        };
        if let Some(unit) = &attribute.unit
            && !UNITS.contains(&unit.value().as_str())
        {
            return Err(Error::new_spanned(
                unit,
                format!("`{}` is no unit known here; units are: {}", unit.value(), UNITS.join(", ")),
            ));
        }
        let unit = attribute.unit.map(|u| u.value()).unwrap_or_default();
        let (min, max) = match &attribute.range {
            Some(range) => {
                let (Some(start), Some(end)) = (&range.start, &range.end) else {
                    return Err(Error::new_spanned(range, "a range has two ends: write `range = 16..=256`"));
                };
                (quote!(Some((#start) as f64)), quote!(Some((#end) as f64)))
            }
            None => (quote!(None), quote!(None)),
        };
        let step = match &attribute.step {
            Some(step) => quote!((#step) as f64),
            None => quote!(0.0),
        };
        let (reopen, must_exist) = (attribute.reopen, attribute.must_exist);
        let default = default_value(default);
        params.push(quote! {
            ::panoscope_node::__private::param(::panoscope_node::__private::Declared {
                name: #param_name,
                doc: #doc,
                unit: #unit,
                kind: <#ty as ::panoscope_node::ParamField>::KIND,
                limits: <#ty as ::panoscope_node::ParamField>::LIMITS,
                choices: <#ty as ::panoscope_node::ParamField>::CHOICES,
                default: #default,
                min: #min,
                max: #max,
                step: #step,
                reopen: #reopen,
                must_exist: #must_exist,
            })
        });
        reads.push(quote! { #ident: <#ty as ::panoscope_node::ParamField>::read(&values[#index])? });
    }
    let count = fields.len();
    Ok(quote! {
        impl ::panoscope_node::Params for #name {
            const PARAMS: &'static [::panoscope_node::abi::Param] = &[#(#params),*];
            fn read(values: &[::panoscope_node::abi::ParamValue]) -> ::panoscope_node::Result<Self> {
                if values.len() != #count {
                    return Err(::panoscope_node::__private::wrong_param_count(#count, values.len()));
                }
                Ok(Self { #(#reads),* })
            }
        }
    })
}
