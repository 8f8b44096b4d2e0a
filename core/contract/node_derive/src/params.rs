//! `#[derive(Params)]`.

use proc_macro2::TokenStream;
use quote::{ToTokens, quote, quote_spanned};
use syn::parse::{Parse, ParseStream};
use syn::spanned::Spanned;
use syn::{
    Data, DeriveInput, Error, Expr, ExprLit, ExprRange, ExprUnary, Fields, Ident, Lit, LitStr, RangeLimits, Result,
    Token, Type, UnOp,
};

use crate::docs;
use crate::nest::Declarations;

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
    "kbit/s",
    "threads",
    "levels",
    "CRF",
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
    must_exist: Option<Ident>,
    writes: Option<Ident>,
    shipped: Option<Ident>,
    pick: Option<Ident>,
    flatten: Option<Ident>,
}

/// Suffixes of parameter names that state a unit, longest first: a reader of a graph file assumes that `window_px` is
/// in pixels.
const ENDINGS: &[(&str, &[&str])] = &[
    ("_mm_s2", &["mm/s2"]),
    ("_px_s", &["px/s"]),
    ("_mm_s", &["mm/s"]),
    ("_rad_s", &["rad/s"]),
    ("_deg_s", &["deg/s"]),
    ("_per_s", &["1/s", "px/s", "mm/s", "rad/s", "deg/s", "frames", "bytes", "MiB"]),
    ("_percent", &["%"]),
    ("_pct", &["%"]),
    ("_px", &["px", "pixels"]),
    ("_mm", &["mm"]),
    ("_m", &["m"]),
    ("_ms", &["ms"]),
    ("_us", &["us"]),
    ("_ns", &["ns"]),
    ("_s", &["s"]),
    ("_hz", &["Hz"]),
    ("_rad", &["rad"]),
    ("_deg", &["deg"]),
    ("_db", &["dB"]),
    ("_bytes", &["bytes"]),
    ("_mib", &["MiB"]),
];

/// Refuses a unit that contradicts the parameter's name.
fn check_ending(name: &str, unit: &LitStr) -> Result<()> {
    let Some((ending, units)) = ENDINGS.iter().find(|(ending, _)| name.ends_with(ending)) else { return Ok(()) };
    if units.contains(&unit.value().as_str()) {
        return Ok(());
    }
    let quoted: Vec<String> = units.iter().map(|unit| format!("\"{unit}\"")).collect();
    let message = format!(
        "`{name}` ends in `{ending}`, its unit is \"{}\": write unit = {}, or give the parameter another name",
        unit.value(),
        quoted.join(" or ")
    );
    Err(Error::new_spanned(unit, message))
}

/// Ways to pick a value in the editor: the word in the attribute, and the flag of the contract.
const PICKS: [(&str, &str); 3] =
    [("points", "PARAM_POINTS"), ("rectangles", "PARAM_RECTANGLES"), ("file", "PARAM_FILE")];

impl Parse for Attribute {
    fn parse(input: ParseStream) -> Result<Self> {
        let mut out = Attribute::default();
        while !input.is_empty() {
            let key: Ident = input.parse()?;
            let twice = match key.to_string().as_str() {
                "default" => out.default.is_some(),
                "range" => out.range.is_some(),
                "step" => out.step.is_some(),
                "unit" => out.unit.is_some(),
                word => out.pick.is_some() && PICKS.iter().any(|(pick, _)| *pick == word),
            };
            if twice {
                return Err(Error::new(key.span(), format!("`{key}` is given twice")));
            }
            match key.to_string().as_str() {
                "reopen" => out.reopen = true,
                "flatten" => out.flatten = Some(key),
                "must_exist" => out.must_exist = Some(key),
                "writes" => out.writes = Some(key),
                "shipped" => out.shipped = Some(key),
                "points" | "rectangles" | "file" => out.pick = Some(key),
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
                        format!(
                            "`{other}` is none of: default, range, step, unit, reopen, must_exist, writes, shipped, points, rectangles, file, flatten"
                        ),
                    ));
                }
            }
            if !input.is_empty() {
                input.parse::<Token![,]>()?;
            }
        }
        if let (Some(flatten), Some(other)) = (&out.flatten, out.other_than_flatten()) {
            let message = format!("a flattened struct declares its parameters itself: remove `{other}`");
            return Err(Error::new_spanned(flatten, message));
        }
        Ok(out)
    }
}

impl Attribute {
    /// The first key other than `flatten`, if there is one.
    fn other_than_flatten(&self) -> Option<String> {
        let flags = [&self.must_exist, &self.writes, &self.shipped, &self.pick];
        let flag = flags.into_iter().flatten().next().map(Ident::to_string);
        let given = [
            (self.default.is_some(), "default"),
            (self.range.is_some(), "range"),
            (self.step.is_some(), "step"),
            (self.unit.is_some(), "unit"),
            (self.reopen, "reopen"),
        ];
        given.iter().find(|(is_given, _)| *is_given).map(|(_, key)| (*key).to_owned()).or(flag)
    }
}

/// Number types that are recognized by name and need a range.
const NUMBERS: &[&str] = &["u8", "u16", "u32", "u64", "usize", "i8", "i16", "i32", "i64", "f32", "f64"];

/// Checks of a declaration. Those that the tokens decide are errors here; the others become assertions with the span of
/// the tokens.
struct Checks {
    asserts: TokenStream,
}

impl Checks {
    /// `known`: value of the condition, where the tokens decide it.
    fn check(&mut self, at: &dyn ToTokens, known: Option<bool>, condition: TokenStream, message: String) -> Result<()> {
        match known {
            Some(true) => {}
            Some(false) => return Err(Error::new_spanned(at.to_token_stream(), message)),
            None => {
                let span = at.to_token_stream().span();
                self.asserts.extend(quote_spanned!(span=> const _: () = ::core::assert!(#condition, "{}", #message);));
            }
        }
        Ok(())
    }
}

/// The number that a literal stands for.
fn literal(expr: &Expr) -> Option<f64> {
    match expr {
        Expr::Lit(ExprLit { lit: Lit::Int(number), .. }) => number.base10_parse().ok(),
        Expr::Lit(ExprLit { lit: Lit::Float(number), .. }) => number.base10_parse().ok(),
        Expr::Unary(ExprUnary { op: UnOp::Neg(_), expr, .. }) => literal(expr).map(|n| -n),
        Expr::Paren(inner) => literal(&inner.expr),
        _ => None,
    }
}

fn checks(ident: &Ident, ty: &Type, attribute: &Attribute, default: &Expr) -> Result<TokenStream> {
    let private = quote!(::panoscope_node::__private);
    let mut out = Checks { asserts: TokenStream::new() };
    let shown = |tokens: &dyn ToTokens| tidy(&tokens.to_token_stream().to_string());
    let (ty_text, default_text) = (shown(ty), shown(default));
    let is_number = NUMBERS.contains(&ty_text.as_str());
    let limits = quote!(<#ty as ::panoscope_node::ParamField>::LIMITS);
    let (fits, what) = match kind_of(default) {
        DefaultKind::Number => (quote!(#private::is_number::<#ty>()), "a number"),
        DefaultKind::Flag => (quote!(#private::is_flag::<#ty>()), "true or false"),
        DefaultKind::Text => (quote!(#private::is_text::<#ty>()), "a text"),
        DefaultKind::Floats(_) => (quote!(#private::is_floats::<#ty>()), "a list of numbers"),
    };
    let known = is_number.then_some(matches!(kind_of(default), DefaultKind::Number));
    out.check(default, known, fits, format!("`{ident}`: {what} is no default for `{ty_text}`"))?;
    if let (DefaultKind::Text, Expr::Lit(ExprLit { lit: Lit::Str(text), .. })) = (kind_of(default), default) {
        let choices = quote!(<#ty as ::panoscope_node::ParamField>::CHOICES_TEXT);
        out.asserts.extend(quote_spanned! {default.span()=>
            const _: () = if !#private::has_word::<#ty>(#text) { ::core::panic!("{}", #choices) };
        });
    }
    if let Some(pick) = &attribute.pick {
        let (fits, what) = match pick == "file" {
            true => (quote!(#private::is_text::<#ty>()), "a text"),
            false => (quote!(#private::is_floats::<#ty>()), "a list of numbers"),
        };
        out.check(pick, None, fits, format!("`{ident}`: `{pick}` is for {what}, this is `{ty_text}`"))?;
    }
    for flag in [&attribute.must_exist, &attribute.writes, &attribute.shipped].into_iter().flatten() {
        let message = format!("`{ident}`: `{flag}` is for a `PathBuf`, this is `{ty_text}`");
        out.check(flag, is_number.then_some(false), quote!(#private::is_path::<#ty>()), message)?;
    }
    if let (Some(writes), Some(other)) =
        (&attribute.writes, attribute.must_exist.as_ref().or(attribute.shipped.as_ref()))
    {
        let message = format!("`{ident}`: a file that is written need not exist: remove `{other}` or `{writes}`");
        return Err(Error::new_spanned(writes, message));
    }
    let Some((range, low, high)) =
        attribute.range.as_ref().and_then(|r| Some((r, r.start.as_deref()?, r.end.as_deref()?)))
    else {
        let message =
            format!("`{ident}`: a number needs a range: `#[param(default = {default_text}, range = 0..=100)]`");
        out.check(ident, is_number.then_some(false), quote!(!#private::is_number::<#ty>()), message)?;
        return Ok(out.asserts);
    };
    let text = format!("{}..={}", shown(low), shown(high));
    let (low_known, high_known, default_known) = (literal(low), literal(high), literal(default));
    let ordered = low_known.zip(high_known).map(|(low, high)| low <= high);
    let (low, high) = (quote!(((#low) as f64)), quote!(((#high) as f64)));
    out.check(range, ordered, quote!(#low <= #high), format!("`{ident}`: the range {text} is empty"))?;
    let inside = quote!(#low >= #limits.0 && #high <= #limits.1);
    out.check(range, None, inside, format!("`{ident}`: the range {text} does not fit into `{ty_text}`"))?;
    match kind_of(default) {
        DefaultKind::Number => {
            let known = low_known.zip(high_known).zip(default_known).map(|((low, high), n)| n >= low && n <= high);
            let inside = quote!((#default) as f64 >= #low && (#default) as f64 <= #high);
            let message = format!("`{ident}`: the default {default_text} lies outside the range {text}");
            out.check(default, known, inside, message)?;
            if let Some(step) = &attribute.step {
                let on = quote!(#private::on_step::<#ty>((#default) as f64, #low, (#step) as f64));
                let step = shown(step);
                let message =
                    format!("`{ident}`: the default {default_text} is not on the steps of {step} from {text}");
                out.check(default, None, on, message)?;
            }
        }
        DefaultKind::Floats(count) => {
            let count = count as f64;
            let known = low_known.zip(high_known).map(|(low, high)| count >= low && count <= high);
            let message = format!("`{ident}`: the default has {count} numbers, the range of lengths is {text}");
            out.check(default, known, quote!(#count >= #low && #count <= #high), message)?;
        }
        DefaultKind::Flag | DefaultKind::Text => {
            let message = format!("`{ident}`: only numbers and lists have a range");
            out.check(range, Some(false), TokenStream::new(), message)?;
        }
    }
    Ok(out.asserts)
}

/// The source text of tokens.
fn tidy(text: &str) -> String {
    let mut out = text.replace("- ", "-");
    for sign in ["<", ">", "::", "(", ")", ","] {
        out = out.replace(&format!(" {sign}"), sign);
        if sign != ">" && sign != "," {
            out = out.replace(&format!("{sign} "), sign);
        }
    }
    out
}

enum DefaultKind {
    Number,
    Flag,
    Text,
    Floats(usize),
}

fn kind_of(default: &Expr) -> DefaultKind {
    match default {
        Expr::Lit(ExprLit { lit: Lit::Str(_), .. }) => DefaultKind::Text,
        Expr::Lit(ExprLit { lit: Lit::Bool(_), .. }) => DefaultKind::Flag,
        Expr::Array(list) => DefaultKind::Floats(list.elems.len()),
        _ => DefaultKind::Number,
    }
}

/// Which kind of default was written is seen from the literal; whether it fits the field is asserted at compile time.
fn default_value(default: &Expr) -> TokenStream {
    let value = quote!(::panoscope_node::__private::DefaultValue);
    match (kind_of(default), default) {
        (DefaultKind::Text, text) => quote!(#value::Text(#text)),
        (DefaultKind::Flag, flag) => quote!(#value::Flag(#flag)),
        (DefaultKind::Floats(_), Expr::Array(list)) => {
            let numbers = list.elems.iter();
            quote!(#value::Floats(&[#((#numbers) as f64),*]))
        }
        (_, number) => quote!(#value::Number((#number) as f64)),
    }
}

/// The declaration of a parameter, and what is asserted of it at compile time.
fn declaration(
    (ident, param_name): (&Ident, &str),
    ty: &Type,
    doc: &str,
    attribute: &Attribute,
) -> Result<(TokenStream, TokenStream)> {
    let Some(default) = &attribute.default else {
        return Err(Error::new_spanned(
            ident,
            format!("parameter `{ident}` needs a default: `#[param(default = ...)]`"),
        ));
    };
    if let Some(unit) = &attribute.unit
        && !UNITS.contains(&unit.value().as_str())
    {
        return Err(Error::new_spanned(
            unit,
            format!("`{}` is no unit known here; units are: {}", unit.value(), UNITS.join(", ")),
        ));
    }
    if let Some(unit) = &attribute.unit {
        check_ending(param_name, unit)?;
    }
    let unit = attribute.unit.as_ref().map(LitStr::value).unwrap_or_default();
    let assert = checks(ident, ty, attribute, default)?;
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
    let (reopen, must_exist) = (attribute.reopen, attribute.must_exist.is_some());
    let (writes, shipped) = (attribute.writes.is_some(), attribute.shipped.is_some());
    let default = default_value(default);
    let flag = attribute.pick.as_ref().and_then(|pick| PICKS.iter().find(|(word, _)| pick == word));
    let pick = match flag {
        Some((_, flag)) => {
            let flag = Ident::new(flag, proc_macro2::Span::call_site());
            quote!(::panoscope_node::abi::#flag)
        }
        None => quote!(0),
    };
    let declared = quote! {
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
            writes: #writes,
            shipped: #shipped,
            pick: #pick,
        })
    };
    Ok((declared, assert))
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
    let mut declared = Declarations::of_params();
    let mut reads = Vec::new();
    let mut asserts = Vec::new();
    for field in fields {
        let ident = field.ident.as_ref().expect("named fields have names");
        let attribute = field.attrs.iter().find(|a| a.path().is_ident("param"));
        let attribute = attribute.map(|attribute| attribute.parse_args::<Attribute>()).transpose()?;
        let ty = &field.ty;
        let index = declared.next_index();
        if let Some(Attribute { flatten: Some(_), .. }) = &attribute {
            let nested = quote_spanned!(ty.span()=> <#ty as ::panoscope_node::Params>);
            reads.push(quote! {
                #ident: {
                    let first = #index;
                    #nested::read(&values[first..first + #nested::PARAMS.len()])?
                }
            });
            declared.nested(ty);
            continue;
        }
        let doc = docs::text(&field.attrs);
        if doc.is_empty() {
            return Err(Error::new_spanned(
                ident,
                format!("parameter `{ident}` needs a doc comment: it is the tooltip that users read"),
            ));
        }
        let Some(attribute) = attribute else {
            return Err(Error::new_spanned(ident, format!("parameter `{ident}` needs `#[param(default = ...)]`")));
        };
        let param_name = ident.to_string();
        let param_name = param_name.trim_start_matches("r#");
        let (declaration, assert) = declaration((ident, param_name), ty, &doc, &attribute)?;
        asserts.push(assert);
        declared.own(param_name, ident, declaration);
        reads.push(quote! { #ident: <#ty as ::panoscope_node::ParamField>::read(&values[#index])? });
    }
    let (unique, list) = declared.finish();
    Ok(quote! {
        #(#asserts)*
        #unique
        impl ::panoscope_node::Params for #name {
            const PARAMS: &'static [::panoscope_node::abi::Param] = #list;
            fn read(values: &[::panoscope_node::abi::ParamValue]) -> ::panoscope_node::Result<Self> {
                let expected = <Self as ::panoscope_node::Params>::PARAMS.len();
                if values.len() != expected {
                    return Err(::panoscope_node::__private::wrong_param_count(expected, values.len()));
                }
                Ok(Self { #(#reads),* })
            }
        }
    })
}
