//! Structs of parameters or ports that are flattened into another.

use proc_macro2::{Group, TokenStream, TokenTree};
use quote::{ToTokens, quote, quote_spanned};
use syn::Type;
use syn::spanned::Spanned;

/// Declarations of a struct, in the order of its fields.
pub struct Declarations {
    /// `Params` or `Ports<'f>`: the trait of a flattened struct.
    nested_trait: TokenStream,
    /// `PARAMS` or `PORTS`: the trait's list.
    list: TokenStream,
    /// `abi::Param` or `abi::Port`.
    element: TokenStream,
    /// The module of `panoscope_node` with the functions on such lists.
    functions: TokenStream,
    /// `parameter` or `port`, for messages.
    kind: &'static str,
    /// Lifetime of a struct of ports, without its quote.
    lifetime: String,
    parts: Vec<Part>,
    asserts: TokenStream,
}

/// Declarations that follow one another.
enum Part {
    /// Fields of the struct itself: name and declaration.
    Own(Vec<(String, TokenStream)>),
    /// A flattened struct.
    Nested(Box<Type>),
}

impl Declarations {
    /// An empty list of parameters.
    pub fn of_params() -> Self {
        Self {
            nested_trait: quote!(::panoscope_node::Params),
            list: quote!(PARAMS),
            element: quote!(::panoscope_node::abi::Param),
            functions: quote!(::panoscope_node::__private::params),
            kind: "parameter",
            lifetime: String::new(),
            parts: Vec::new(),
            asserts: TokenStream::new(),
        }
    }

    /// An empty list of ports of a struct with this lifetime. Flattened types must have `'static` instead, see
    /// [`with_static`].
    pub fn of_ports(lifetime: &str) -> Self {
        Self {
            nested_trait: quote!(::panoscope_node::Ports<'static>),
            list: quote!(PORTS),
            element: quote!(::panoscope_node::abi::Port),
            functions: quote!(::panoscope_node::__private::ports),
            kind: "port",
            lifetime: lifetime.to_owned(),
            parts: Vec::new(),
            asserts: TokenStream::new(),
        }
    }

    /// The list of a flattened struct. Errors about it point at the field's type.
    fn list_of(&self, ty: &Type) -> TokenStream {
        let (nested_trait, list) = (&self.nested_trait, &self.list);
        quote_spanned!(ty.span()=> <#ty as #nested_trait>::#list)
    }

    /// The index of the next declaration, as an expression.
    pub fn next_index(&self) -> TokenStream {
        let own: usize = self.parts.iter().map(|part| if let Part::Own(own) = part { own.len() } else { 0 }).sum();
        let nested = self.parts.iter().filter_map(|part| match part {
            Part::Own(_) => None,
            Part::Nested(ty) => Some(self.list_of(ty)),
        });
        quote!(#own #(+ #nested.len())*)
    }

    /// Adds a field of the struct itself.
    pub fn own(&mut self, name: &str, span: &dyn ToTokens, declaration: TokenStream) {
        for part in &self.parts {
            if let Part::Nested(ty) = part {
                self.asserts.extend(self.differs(ty, name, span));
            }
        }
        let entry = (name.to_owned(), declaration);
        match self.parts.last_mut() {
            Some(Part::Own(own)) => own.push(entry),
            _ => self.parts.push(Part::Own(vec![entry])),
        }
    }

    /// Adds a flattened struct.
    pub fn nested(&mut self, ty: &Type) {
        for part in &self.parts {
            let assert = match part {
                Part::Own(own) => own.iter().map(|(name, _)| self.differs(ty, name, ty)).collect(),
                Part::Nested(other) => {
                    let (one, two) = (self.list_of(other), self.list_of(ty));
                    let message = format!(
                        "`{}` and `{}` have a {} of the same name: rename one of them",
                        shown(other),
                        shown(ty),
                        self.kind
                    );
                    let functions = &self.functions;
                    quote_spanned! {ty.span()=>
                        const _: () = ::core::assert!(#functions::are_disjoint(#one, #two), "{}", #message);
                    }
                }
            };
            self.asserts.extend(assert);
        }
        self.parts.push(Part::Nested(Box::new(ty.clone())));
    }

    /// An assertion that a flattened struct has no declaration of this name.
    fn differs(&self, ty: &Type, name: &str, at: &(impl ToTokens + ?Sized)) -> TokenStream {
        let (list, functions) = (self.list_of(ty), &self.functions);
        let message =
            format!("`{}`, which is flattened here, has a {} `{name}` too: rename one of them", shown(ty), self.kind);
        quote_spanned! {at.to_token_stream().span()=>
            const _: () = ::core::assert!(!#functions::has_name(#list, #name), "{}", #message);
        }
    }

    /// The assertions, as items, and the list of all declarations, as an expression.
    pub fn finish(self) -> (TokenStream, TokenStream) {
        let (element, functions) = (&self.element, &self.functions);
        let count = self.next_index();
        let is_flat = self.parts.iter().all(|part| matches!(part, Part::Own(_)));
        let parts = self.parts.iter().map(|part| match part {
            Part::Own(own) => {
                let own = own.iter().map(|(_, declaration)| declaration);
                quote!(&[#(#own),*])
            }
            Part::Nested(ty) => self.list_of(ty),
        });
        let list = if is_flat {
            quote!(#(#parts)*)
        } else {
            // Items cannot name the lifetime of the `impl` around them.
            let parts = parts.map(|part| with_static(part, &self.lifetime));
            quote!({
                const COUNT: usize = #count;
                const ALL: [#element; COUNT] = #functions::concat(&[#(#parts),*]);
                &ALL
            })
        };
        (self.asserts, if self.parts.is_empty() { quote!(&[]) } else { list })
    }
}

/// The source text of a type.
fn shown(ty: &Type) -> String {
    ty.to_token_stream().to_string().replace(' ', "").replace("'static", "'_")
}

/// `tokens` with `lifetime` replaced by `'static`: items inside an `impl` cannot name its lifetime.
pub fn with_static(tokens: TokenStream, lifetime: &str) -> TokenStream {
    let mut out = Vec::new();
    let mut after_quote = false;
    for token in tokens {
        let token = match token {
            TokenTree::Group(group) => {
                let mut inner = Group::new(group.delimiter(), with_static(group.stream(), lifetime));
                inner.set_span(group.span());
                TokenTree::Group(inner)
            }
            TokenTree::Ident(ident) if after_quote && ident == lifetime => {
                TokenTree::Ident(proc_macro2::Ident::new("static", ident.span()))
            }
            other => other,
        };
        after_quote = matches!(&token, TokenTree::Punct(punct) if punct.as_char() == '\'');
        out.push(token);
    }
    out.into_iter().collect()
}
