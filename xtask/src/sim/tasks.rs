//! The task names that belong to the exceptions of an RTIC application.

use std::collections::{BTreeMap, BTreeSet};

use syn::{
    Attribute, File, Ident, Item, LitInt, Token, parse::ParseStream, punctuated::Punctuated,
};

/// Task by exception, read from the source of an RTIC application.
///
/// A hardware task has the exception that it binds. The software tasks of one
/// priority share a dispatcher and are named together; RTIC gives the highest
/// priority the last dispatcher of the list.
///
/// # Errors
///
/// The source is not Rust, or no RTIC application of the form that the nodes have.
pub(super) fn names(source: &str) -> syn::Result<BTreeMap<String, String>> {
    let file: File = syn::parse_str(source)?;
    let mut names = BTreeMap::new();
    for item in &file.items {
        let Item::Mod(module) = item else { continue };
        let Some(app) = module.attrs.iter().find(|a| is(a, &["rtic", "app"])) else {
            continue;
        };
        let mut software: BTreeMap<u8, BTreeSet<String>> = BTreeMap::new();
        let items = module.content.iter().flat_map(|(_, items)| items);
        for item in items {
            let Item::Fn(function) = item else { continue };
            let Some(task) = function.attrs.iter().find(|a| is(a, &["task"])) else {
                continue;
            };
            let name = function.sig.ident.to_string();
            let task = Task::parse(task)?;
            match task.binds {
                Some(exception) => {
                    names.insert(exception, name);
                }
                None => {
                    software.entry(task.priority).or_default().insert(name);
                }
            }
        }
        let mut dispatchers = dispatchers(app)?;
        for (_, tasks) in software.into_iter().rev().filter(|(p, _)| *p > 0) {
            if let Some(dispatcher) = dispatchers.pop() {
                let tasks: Vec<String> = tasks.into_iter().collect();
                names.insert(dispatcher, tasks.join("+"));
            }
        }
    }
    Ok(names)
}

fn is(attribute: &Attribute, path: &[&str]) -> bool {
    let segments = &attribute.path().segments;
    segments.len() == path.len() && segments.iter().zip(path).all(|(s, p)| s.ident == p)
}

/// The used arguments of a `#[task(..)]`.
#[derive(Default)]
struct Task {
    binds: Option<String>,
    /// 0 is RTIC's default for software tasks.
    priority: u8,
}

impl Task {
    fn parse(attribute: &Attribute) -> syn::Result<Self> {
        let mut task = Task::default();
        if matches!(attribute.meta, syn::Meta::Path(_)) {
            return Ok(task);
        }
        attribute.parse_nested_meta(|meta| {
            let value = meta.value()?;
            if meta.path.is_ident("binds") {
                task.binds = Some(value.parse::<Ident>()?.to_string());
            } else if meta.path.is_ident("priority") {
                task.priority = value.parse::<LitInt>()?.base10_parse()?;
            } else {
                skip(value)?;
            }
            Ok(())
        })?;
        Ok(task)
    }
}

fn dispatchers(app: &Attribute) -> syn::Result<Vec<String>> {
    let mut dispatchers = Vec::new();
    app.parse_nested_meta(|meta| {
        let value = meta.value()?;
        if meta.path.is_ident("dispatchers") {
            let list;
            syn::bracketed!(list in value);
            let list = Punctuated::<Ident, Token![,]>::parse_terminated(&list)?;
            dispatchers = list.iter().map(Ident::to_string).collect();
        } else {
            skip(value)?;
        }
        Ok(())
    })?;
    Ok(dispatchers)
}

/// Skips a value up to the next comma.
fn skip(value: ParseStream) -> syn::Result<()> {
    while !value.is_empty() && !value.peek(Token![,]) {
        value.step(|cursor| match cursor.token_tree() {
            Some((_, rest)) => Ok(((), rest)),
            None => Ok(((), *cursor)),
        })?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hardware_tasks_and_dispatchers_get_their_names() {
        let source = r#"
            #[rtic::app(device = some::pac, peripherals = true, dispatchers = [EXTI1, EXTI2])]
            mod app {
                #[init(local = [stack: Option<u8> = None])]
                fn init(cx: init::Context) -> (Shared, Local) { todo() }
                #[task(binds = TIM2, priority = 6, local = [count: u32 = 0], shared = [&clock])]
                fn window(cx: window::Context) {}
                #[task(priority = 1)]
                async fn console(cx: console::Context) {}
                #[task(shared = [x], priority = 3)]
                async fn control(cx: control::Context) {}
                #[task(priority = 3)]
                async fn alarm(cx: alarm::Context) {}
            }
        "#;
        let names = names(source).unwrap();
        let name = |exception: &str| names.get(exception).map(String::as_str);
        assert_eq!(name("TIM2"), Some("window"));
        assert_eq!(name("EXTI2"), Some("alarm+control"));
        assert_eq!(name("EXTI1"), Some("console"));
        assert_eq!(names.len(), 3);
    }

    #[test]
    fn the_nodes_name_their_protocol_tasks() {
        let sources = [
            include_str!("../../../firmware/vehicles/uagv/nodes/gps.rs"),
            include_str!("../../../firmware/vehicles/uagv/nodes/controller.rs"),
            include_str!("../../../firmware/vehicles/uagv/nodes/steering.rs"),
            include_str!("../../../firmware/vehicles/uagv/nodes/drive.rs"),
        ];
        for source in sources {
            let names = names(source).unwrap();
            assert_eq!(names.get("TIM2").map(String::as_str), Some("window_timer"));
        }
        // The report prints the thesis's figures beside these two.
        let controller = names(sources[1]).unwrap();
        for task in ["control", "display_tick"] {
            assert!(controller.values().any(|name| name == task), "{task}");
        }
    }
}
