//! Reads the modules of a crate, and what they use of each other, from its source.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use syn::visit::{self, Visit};
use syn::{Attribute, File, Item, ItemMod, ItemUse, UseTree, Visibility};

/// `["track", "align"]` for `crate::track::align`; empty for the crate itself.
pub type Name = Vec<String>;

/// A module without its tests.
#[derive(Default)]
struct Module {
    file: PathBuf,
    children: BTreeSet<String>,
    /// Names that it re-exports, and where they come from.
    exports: BTreeMap<String, Name>,
    /// Paths that it uses, from the crate's root.
    used: BTreeSet<Name>,
}

/// All modules of a crate.
#[derive(Default)]
pub struct Modules(BTreeMap<Name, Module>);

impl Modules {
    /// Reads the crate of a `lib.rs`, without the modules that exist only for tests.
    pub fn of(lib: &Path) -> Self {
        let mut modules = Self::default();
        modules.read(Vec::new(), lib, lib.parent().expect("lib.rs is in a folder"));
        modules
    }

    fn read(&mut self, name: Name, file: &Path, folder: &Path) {
        let text = std::fs::read_to_string(file).unwrap_or_else(|e| panic!("{}: {e}", file.display()));
        let parsed: File = syn::parse_file(&text).unwrap_or_else(|e| panic!("{}: {e}", file.display()));
        let mut reader = Reader { name: name.clone(), module: Module { file: file.to_owned(), ..Module::default() } };
        let declared: Vec<&ItemMod> = parsed.items.iter().filter_map(declaration).collect();
        reader.module.children = declared.iter().map(|m| m.ident.to_string()).collect();
        reader.visit_file(&parsed);
        self.0.insert(name.clone(), reader.module);
        for child in declared {
            let ident = child.ident.to_string();
            let places = [folder.join(format!("{ident}.rs")), folder.join(&ident).join("mod.rs")];
            let found: &PathBuf = places.iter().find(|p| p.exists()).unwrap_or_else(|| panic!("no file of {name:?}::{ident}"));
            self.read([name.as_slice(), std::slice::from_ref(&ident)].concat(), found, &folder.join(&ident));
        }
    }

    /// Returns the module that a path leads to, through re-exports.
    fn module_of(&self, path: &[String], steps: usize) -> Name {
        let mut at = Name::new();
        for (k, segment) in path.iter().enumerate() {
            let Some(module) = self.0.get(&at) else { break };
            if module.children.contains(segment) {
                at.push(segment.clone());
            } else {
                return match module.exports.get(segment) {
                    Some(target) if steps > 0 => self.module_of(&[target.as_slice(), &path[k + 1..]].concat(), steps - 1),
                    _ => at,
                };
            }
        }
        at
    }

    /// Returns which module uses which: (user, used).
    pub fn uses(&self) -> BTreeSet<(Name, Name)> {
        let arrows = self.0.iter().flat_map(|(name, module)| module.used.iter().map(|path| (name.clone(), self.module_of(path, 8))));
        arrows.filter(|(user, used)| user != used).collect()
    }

    /// Returns the files of all modules.
    pub fn files(&self) -> impl Iterator<Item = &Path> {
        self.0.values().map(|module| module.file.as_path())
    }

    /// Returns the modules that have child modules, with their children.
    pub fn parents(&self) -> impl Iterator<Item = (&Name, &BTreeSet<String>)> {
        self.0.iter().filter(|(_, module)| !module.children.is_empty()).map(|(name, module)| (name, &module.children))
    }
}

/// Returns a module in a file of its own, unless it exists only for tests.
fn declaration(item: &Item) -> Option<&ItemMod> {
    match item {
        Item::Mod(m) if m.content.is_none() && !is_test(&m.attrs) => Some(m),
        _ => None,
    }
}

/// Whether the attributes have `#[cfg(test)]`, `#[cfg(all(test, …))]` or `#[test]`.
fn is_test(attributes: &[Attribute]) -> bool {
    attributes.iter().any(|a| {
        let condition = a.meta.require_list().ok().filter(|list| list.path.is_ident("cfg")).map(|list| list.tokens.to_string());
        a.path().is_ident("test") || condition.is_some_and(|c| c.split(|l: char| !l.is_alphanumeric()).any(|word| word == "test"))
    })
}

struct Reader {
    name: Name,
    module: Module,
}

impl Reader {
    /// Resolves a path of this module from the crate's root; `None` if it leads out of the crate.
    fn path_from_root(&self, path: &[String]) -> Option<Name> {
        let (first, rest) = path.split_first()?;
        let parent = |name: &Name| name[..name.len().saturating_sub(1)].to_vec();
        let (mut at, mut rest) = match first.as_str() {
            "crate" => (Name::new(), rest),
            "self" => (self.name.clone(), rest),
            "super" => (parent(&self.name), rest),
            child if self.module.children.contains(child) => (self.name.clone(), path),
            _ => return None,
        };
        while let Some(("super", after)) = rest.split_first().map(|(s, after)| (s.as_str(), after)) {
            (at, rest) = (parent(&at), after);
        }
        at.extend(rest.iter().cloned());
        Some(at)
    }

    fn add_tree(&mut self, before: &mut Name, tree: &UseTree, is_given_on: bool) {
        match tree {
            UseTree::Path(path) => {
                before.push(path.ident.to_string());
                self.add_tree(before, &path.tree, is_given_on);
                before.pop();
            }
            UseTree::Group(group) => group.items.iter().for_each(|item| self.add_tree(before, item, is_given_on)),
            UseTree::Glob(_) => self.add(before, None),
            UseTree::Name(name) if name.ident == "self" => self.add(before, before.last().cloned().filter(|_| is_given_on)),
            UseTree::Name(name) => {
                before.push(name.ident.to_string());
                self.add(before, Some(name.ident.to_string()).filter(|_| is_given_on));
                before.pop();
            }
            UseTree::Rename(rename) => {
                before.push(rename.ident.to_string());
                self.add(before, Some(rename.rename.to_string()).filter(|_| is_given_on));
                before.pop();
            }
        }
    }

    /// Records a path, and the name under which it is re-exported.
    fn add(&mut self, path: &[String], given_on_as: Option<String>) {
        let Some(path) = self.path_from_root(path) else { return };
        // A parent that re-exports its own children does not depend on them.
        if given_on_as.is_none() || !path.starts_with(&self.name) || path.len() <= self.name.len() {
            self.module.used.insert(path.clone());
        }
        if let Some(name) = given_on_as {
            self.module.exports.insert(name, path);
        }
    }
}

impl<'a> Visit<'a> for Reader {
    fn visit_item(&mut self, item: &'a Item) {
        let attributes = match item {
            Item::Mod(i) => &i.attrs,
            Item::Fn(i) => &i.attrs,
            Item::Use(i) => &i.attrs,
            Item::Impl(i) => &i.attrs,
            Item::Struct(i) => &i.attrs,
            Item::Const(i) => &i.attrs,
            _ => return visit::visit_item(self, item),
        };
        if !is_test(attributes) {
            visit::visit_item(self, item);
        }
    }

    fn visit_item_use(&mut self, item: &'a ItemUse) {
        let is_given_on = !matches!(item.vis, Visibility::Inherited);
        self.add_tree(&mut Name::new(), &item.tree, is_given_on);
    }

    fn visit_path(&mut self, path: &'a syn::Path) {
        let segments: Name = path.segments.iter().map(|s| s.ident.to_string()).collect();
        if segments.len() > 1 {
            self.add(&segments, None);
        }
        visit::visit_path(self, path);
    }
}
