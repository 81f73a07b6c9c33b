//! The derive macro of `re4_fault::Remedy`.

use proc_macro2::{Delimiter, TokenStream, TokenTree};
use quote::{format_ident, quote};
use syn::{Attribute, Data, DeriveInput, Fields, Meta, parse_macro_input};

/// Implements `re4_fault::Remedy`. The remedy of each variant (or of the struct) is given by an attribute below its `#[error]`.
///
/// `#[remedy("remove {} and run again", path.display())]` takes the arguments of `format!`. Fields are available by their names,
/// those of tuples as `_0`, `_1`. If the first argument is not a string literal, it is an expression of type `Option<Cow<str>>`,
/// as in `#[remedy(fault.remedy())]`. Without the attribute there is no remedy.
#[proc_macro_derive(Remedy, attributes(remedy))]
pub fn derive_remedy(input: proc_macro::TokenStream) -> proc_macro::TokenStream {
    let input = parse_macro_input!(input as DeriveInput);
    let arms: Result<Vec<TokenStream>, syn::Error> = match &input.data {
        Data::Enum(data) => data
            .variants
            .iter()
            .map(|variant| {
                let name = &variant.ident;
                arm(&quote!(Self::#name), &variant.fields, &variant.attrs)
            })
            .collect(),
        Data::Struct(data) => arm(&quote!(Self), &data.fields, &input.attrs).map(|arm| vec![arm]),
        Data::Union(_) => Err(syn::Error::new_spanned(
            &input.ident,
            "Remedy cannot be derived for unions",
        )),
    };
    let arms = match arms {
        Ok(arms) => arms,
        Err(error) => return error.to_compile_error().into(),
    };
    let name = &input.ident;
    let (generics, arguments, bounds) = input.generics.split_for_impl();
    quote! {
        impl #generics ::re4_fault::Remedy for #name #arguments #bounds {
            #[allow(unused_variables)]
            fn remedy(&self) -> ::std::option::Option<::std::borrow::Cow<'_, str>> {
                match self { #(#arms)* }
            }
        }
    }
    .into()
}

/// Returns the match arm of a variant: its pattern and its remedy.
fn arm(name: &TokenStream, fields: &Fields, attributes: &[Attribute]) -> Result<TokenStream, syn::Error> {
    let pattern = match fields {
        Fields::Unit => name.clone(),
        Fields::Named(fields) => {
            let names = fields.named.iter().map(|field| &field.ident);
            quote!(#name { #(#names),* })
        }
        Fields::Unnamed(fields) => {
            let names = (0..fields.unnamed.len()).map(|place| format_ident!("_{place}"));
            quote!(#name(#(#names),*))
        }
    };
    let attribute = attributes.iter().find(|attribute| attribute.path().is_ident("remedy"));
    let remedy = match attribute.map(|attribute| &attribute.meta) {
        None => quote!(::std::option::Option::None),
        Some(Meta::List(list)) if begins_with_text(&list.tokens) => {
            let text = &list.tokens;
            quote!(::std::option::Option::Some(::std::borrow::Cow::Owned(
                ::std::format!(#text)
            )))
        }
        Some(Meta::List(list)) => list.tokens.clone(),
        Some(other) => return Err(syn::Error::new_spanned(other, "expected #[remedy(\"text\")]")),
    };
    Ok(quote!(#pattern => { #remedy }))
}

/// Whether the first token is a literal. A literal that was passed through a `macro_rules` macro is in a group without
/// delimiters.
fn begins_with_text(tokens: &TokenStream) -> bool {
    match tokens.clone().into_iter().next() {
        Some(TokenTree::Literal(_)) => true,
        Some(TokenTree::Group(group)) if group.delimiter() == Delimiter::None => begins_with_text(&group.stream()),
        _ => false,
    }
}
