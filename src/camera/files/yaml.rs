//! A YAML text as a tree with line numbers.
//!
//! Built from the parser's events without recursion, with bounded depth and without aliases, so
//! that no text can exhaust the stack or the memory. OpenCV's `%YAML:1.0` line is not YAML and is
//! blanked first.

use yaml_rust2::Event;
use yaml_rust2::parser::Parser;

use super::problem::{CalibrationProblem, Fault};

/// A value and the line of it or its key, from 1.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Node {
    pub line: usize,
    pub content: Content,
}

#[derive(Debug, Clone, PartialEq)]
pub(super) enum Content {
    Scalar(String),
    List(Vec<Node>),
    Map(Vec<(String, Node)>),
}

/// Maximum nesting of lists and maps; real calibrations need at most a matrix in a camera's map.
/// Bounds the cost of a hostile file: raised, it may cost more.
const DEEPEST: usize = 16;

fn syntax(line: usize, reason: impl Into<String>) -> Fault {
    Fault { line: Some(line), problem: CalibrationProblem::Syntax { reason: reason.into() } }
}

/// Parses the first document of a YAML text; an empty text is an empty map.
pub(super) fn parse(text: &str) -> Result<Node, Fault> {
    let strict: String = text.lines().map(|l| if l.starts_with("%YAML") { "\n".to_owned() } else { format!("{l}\n") }).collect();
    let strict = strict.replace("!!opencv-matrix", "");
    let mut parser = Parser::new_from_str(&strict);
    let mut open: Vec<Open> = Vec::new();
    loop {
        let (event, mark) = parser.next_token().map_err(|e| syntax(e.marker().line().max(1), e.info().to_owned()))?;
        let line = mark.line().max(1);
        let finished = match event {
            Event::StreamEnd | Event::DocumentEnd => return Ok(Node { line: 1, content: Content::Map(Vec::new()) }),
            Event::Alias(_) => return Err(syntax(line, "aliases (*name) are not read here")),
            Event::Scalar(value, ..) => Some(Node { line, content: Content::Scalar(value) }),
            Event::SequenceStart(..) => {
                open.push(Open { node: Node { line, content: Content::List(Vec::new()) }, key: None });
                None
            }
            Event::MappingStart(..) => {
                open.push(Open { node: Node { line, content: Content::Map(Vec::new()) }, key: None });
                None
            }
            Event::SequenceEnd | Event::MappingEnd => open.pop().map(|o| o.node),
            Event::Nothing | Event::StreamStart | Event::DocumentStart => None,
        };
        if open.len() > DEEPEST {
            return Err(syntax(line, "lists and maps are nested too deeply for a calibration"));
        }
        if let Some(node) = finished {
            match open.last_mut() {
                Some(parent) => parent.take(node)?,
                None => return Ok(node),
            }
        }
    }
}

/// An unfinished list or map, and the key that awaits its value.
struct Open {
    node: Node,
    key: Option<(String, usize)>,
}

impl Open {
    fn take(&mut self, child: Node) -> Result<(), Fault> {
        match &mut self.node.content {
            Content::List(items) => items.push(child),
            Content::Map(entries) => match (self.key.take(), child.content) {
                (Some((key, line)), content) => {
                    if let Some((typed, before)) = entries.iter().find(|(known, _)| plain(known) == plain(&key)) {
                        return Err(syntax(line, format!("`{key}` is repeated here, after `{typed}` in line {}; remove one", before.line)));
                    }
                    entries.push((key, Node { line, content }));
                }
                (None, Content::Scalar(key)) => self.key = Some((key, child.line)),
                (None, _) => return Err(syntax(child.line, "a key must be a plain word")),
            },
            Content::Scalar(_) => {}
        }
        Ok(())
    }
}

/// Normalises a key: files spell the same key in several ways.
fn plain(name: &str) -> String {
    name.replace('_', "").to_ascii_lowercase()
}

impl Node {
    /// Finds the first of `names` in the map, ignoring case and underscores; returns the name as
    /// typed and its value.
    pub fn find(&self, names: &[&str]) -> Option<(&str, &Node)> {
        let Content::Map(entries) = &self.content else { return None };
        let one = |name: &&str| entries.iter().find(|(k, _)| plain(k) == plain(name)).map(|(k, v)| (k.as_str(), v));
        names.iter().find_map(one)
    }

    /// Parses a number; OpenCV writes `.Nan` and `.Inf`.
    pub fn number(&self) -> Option<f64> {
        let Content::Scalar(text) = &self.content else { return None };
        match text.to_ascii_lowercase().as_str() {
            ".nan" => Some(f64::NAN),
            ".inf" | "+.inf" => Some(f64::INFINITY),
            "-.inf" => Some(f64::NEG_INFINITY),
            other => other.parse().ok(),
        }
    }

    /// Returns the text of a scalar.
    pub fn text(&self) -> Option<&str> {
        if let Content::Scalar(text) = &self.content { Some(text) } else { None }
    }

    /// Returns the numbers of a list, a list of lists, or a matrix map with `data`; `None` if
    /// anything in it is not a number.
    pub fn numbers(&self) -> Option<Vec<f64>> {
        match &self.content {
            Content::Scalar(_) => None,
            Content::Map(_) => self.find(&["data"])?.1.numbers(),
            Content::List(items) => {
                let mut all = Vec::new();
                for item in items {
                    match item.number() {
                        Some(number) => all.push(number),
                        None => all.extend(item.numbers()?),
                    }
                }
                Some(all)
            }
        }
    }
}

/// Converts a node's number to a whole number of pixels.
///
/// # Errors
/// When it is not a whole number.
pub(super) fn whole(key: &str, node: &Node, number: f64) -> Result<u32, Fault> {
    if number.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(&number) {
        return Ok(number as u32);
    }
    let problem = CalibrationProblem::OutOfRange { key: key.to_owned(), value: number, expected: "a whole number of pixels" };
    Err(Fault { line: Some(node.line), problem })
}
