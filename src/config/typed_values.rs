//! Single values as they stand in the file, for which TOML's own types are too wide or too narrow.

use std::fmt;
use std::marker::PhantomData;

use serde::Deserialize;
use serde::de::{self, Visitor};
use toml::Spanned;

/// A finite or infinite number, typed with or without a decimal point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Number(pub f64);

/// A whole number, at least 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Count(pub u64);

/// A driver control's value: a level, a menu entry, or a switch (1 = on).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ControlValue(pub i64);

/// An array of exactly N entries.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exactly<T, const N: usize>(pub [T; N]);

/// One text, or several in an array.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Texts {
    /// Without brackets.
    One(String),
    /// In brackets.
    Several(Vec<Spanned<String>>),
}

/// A point of a picture: a named one, or a pixel.
#[derive(Debug, Clone, PartialEq)]
pub enum PictureWord {
    /// A corner, the middle of a side, the centre.
    Named(String),
    /// Column and row.
    Pixel([f64; 2]),
}

impl Texts {
    /// Returns all texts, each with its place.
    pub fn all(typed: &Spanned<Self>) -> Vec<Spanned<String>> {
        match typed.get_ref() {
            Self::One(text) => vec![Spanned::new(typed.span(), text.clone())],
            Self::Several(texts) => texts.clone(),
        }
    }
}

impl<const N: usize> Exactly<Number, N> {
    /// Returns the bare numbers.
    pub fn values(&self) -> [f64; N] {
        self.0.map(|Number(v)| v)
    }
}

struct NumberVisitor;
impl Visitor<'_> for NumberVisitor {
    type Value = Number;
    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number")
    }
    fn visit_f64<E: de::Error>(self, v: f64) -> Result<Number, E> {
        Ok(Number(v))
    }
    fn visit_i64<E: de::Error>(self, v: i64) -> Result<Number, E> {
        Ok(Number(v as f64))
    }
    fn visit_u64<E: de::Error>(self, v: u64) -> Result<Number, E> {
        Ok(Number(v as f64))
    }
}

struct CountVisitor;
impl Visitor<'_> for CountVisitor {
    type Value = Count;
    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a whole number of 0 or more")
    }
    fn visit_i64<E: de::Error>(self, v: i64) -> Result<Count, E> {
        u64::try_from(v).map(Count).map_err(|_| E::invalid_value(de::Unexpected::Signed(v), &self))
    }
    fn visit_u64<E: de::Error>(self, v: u64) -> Result<Count, E> {
        Ok(Count(v))
    }
}

struct ControlVisitor;
impl Visitor<'_> for ControlVisitor {
    type Value = ControlValue;
    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a whole number, true or false")
    }
    fn visit_i64<E: de::Error>(self, v: i64) -> Result<ControlValue, E> {
        Ok(ControlValue(v))
    }
    fn visit_bool<E: de::Error>(self, v: bool) -> Result<ControlValue, E> {
        Ok(ControlValue(i64::from(v)))
    }
}

struct TextsVisitor;
impl<'de> Visitor<'de> for TextsVisitor {
    type Value = Texts;
    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a text in quotes, or several in an array")
    }
    fn visit_str<E: de::Error>(self, text: &str) -> Result<Texts, E> {
        Ok(Texts::One(text.to_owned()))
    }
    fn visit_seq<A: de::SeqAccess<'de>>(self, mut entries: A) -> Result<Texts, A::Error> {
        let mut read = Vec::new();
        while let Some(entry) = entries.next_element()? {
            read.push(entry);
        }
        Ok(Texts::Several(read))
    }
}

struct PictureWordVisitor;
impl<'de> Visitor<'de> for PictureWordVisitor {
    type Value = PictureWord;
    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a point's name, or its pixel [u, v]")
    }
    fn visit_str<E: de::Error>(self, text: &str) -> Result<PictureWord, E> {
        Ok(PictureWord::Named(text.to_owned()))
    }
    fn visit_seq<A: de::SeqAccess<'de>>(self, entries: A) -> Result<PictureWord, A::Error> {
        let pixel: Exactly<Number, 2> = ExactlyVisitor(PhantomData).visit_seq(entries)?;
        Ok(PictureWord::Pixel(pixel.values()))
    }
}

struct ExactlyVisitor<T, const N: usize>(PhantomData<T>);
impl<'de, T: Deserialize<'de>, const N: usize> Visitor<'de> for ExactlyVisitor<T, N> {
    type Value = Exactly<T, N>;
    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "an array of {N} entries")
    }
    fn visit_seq<A: de::SeqAccess<'de>>(self, mut entries: A) -> Result<Self::Value, A::Error> {
        let mut read = Vec::with_capacity(N);
        while let Some(entry) = entries.next_element()? {
            read.push(entry);
        }
        <[T; N]>::try_from(read).map(Exactly).map_err(|read| de::Error::invalid_length(read.len(), &self))
    }
}

impl<'de, T: Deserialize<'de>, const N: usize> Deserialize<'de> for Exactly<T, N> {
    fn deserialize<D: de::Deserializer<'de>>(d: D) -> Result<Self, D::Error> {
        d.deserialize_any(ExactlyVisitor(PhantomData))
    }
}

impl<'de> Deserialize<'de> for PictureWord {
    fn deserialize<D: de::Deserializer<'de>>(d: D) -> Result<Self, D::Error> {
        d.deserialize_any(PictureWordVisitor)
    }
}

impl<'de> Deserialize<'de> for Number {
    fn deserialize<D: de::Deserializer<'de>>(d: D) -> Result<Self, D::Error> {
        d.deserialize_any(NumberVisitor)
    }
}

impl<'de> Deserialize<'de> for Texts {
    fn deserialize<D: de::Deserializer<'de>>(d: D) -> Result<Self, D::Error> {
        d.deserialize_any(TextsVisitor)
    }
}

impl<'de> Deserialize<'de> for Count {
    fn deserialize<D: de::Deserializer<'de>>(d: D) -> Result<Self, D::Error> {
        d.deserialize_any(CountVisitor)
    }
}

impl<'de> Deserialize<'de> for ControlValue {
    fn deserialize<D: de::Deserializer<'de>>(d: D) -> Result<Self, D::Error> {
        d.deserialize_any(ControlVisitor)
    }
}
