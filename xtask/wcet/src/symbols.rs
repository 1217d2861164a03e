//! Symbols: unknown words that the analysis recognises again, and the facts about them.

use std::collections::HashMap;

use rsemu::cpu::arm::v7m::isa::ExtendOp;

use super::extent::Extent;
use super::image::Variables;
use super::layout::NO_NUMBER;
use super::range::Range;
use super::value::{Symbol, Value};

/// The quantity that a symbol stands for, where it is known.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Definition {
    /// One of these words, in order.
    OneOf(Vec<u32>),
    /// `(of * factor) >> shift`, computed without loss, for a dividend below 2^32. Compilers
    /// divide by a constant this way.
    Scaled {
        /// The dividend.
        of: Value,
        /// The factor.
        factor: u32,
        /// The shift, 32 or more.
        shift: u32,
    },
    /// The quotient of a division.
    Quotient {
        /// The dividend.
        of: Value,
        /// The divisor.
        by: Value,
    },
    /// A product of two words.
    Product(Value, Value),
    /// The enabled ones among the first 32 interrupts, as the interrupt controller had them, masked.
    Enabled {
        /// The symbol of the moment at which they were read: the later, the greater.
        read: Symbol,
        /// The mask.
        mask: u32,
    },
}

/// The variable from whose address a word was computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Source {
    /// This static variable.
    Variable(Extent),
    /// The word is a distance to or from a variable. An address plus this distance need not
    /// lie in the variable of that address.
    Difference,
    /// None, as far as is known.
    Unknown,
}

/// Elements up to which a set of words is kept; a larger one becomes a range.
pub(crate) const MAX_ELEMENTS: usize = 256;

/// Bytes by which a folded index moves the address of an element, at most.
const FOLDED: u32 = 32;

/// A sum of a symbol and the constant address of an array element.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Indexed {
    /// Offset of the sum from the symbol.
    sum: u32,
    /// The constant address.
    element: u32,
}

/// Creates symbols and stores the facts about them.
#[derive(Debug, Default)]
pub struct Symbols {
    last: u32,
    definitions: HashMap<Symbol, Definition>,
    /// The static variables of the image.
    variables: Variables,
    /// Sums of a symbol and the constant address of an array element, by symbol.
    indices: HashMap<Symbol, Vec<Indexed>>,
    /// Sources of symbols, unknown ones left out.
    sources: HashMap<Symbol, Source>,
    /// Extensions of the sum of a symbol and a constant.
    extensions: HashMap<(ExtendOp, Symbol, u32), Symbol>,
    /// True if two paths met of which only one had let tasks run.
    pub mixed: bool,
}

impl Symbols {
    /// Without any symbol, for an image with these variables.
    #[must_use]
    pub fn new(variables: &Variables) -> Self {
        Self {
            variables: variables.clone(),
            ..Self::default()
        }
    }

    /// A new symbol.
    pub fn fresh(&mut self) -> Symbol {
        self.last += 1;
        Symbol(self.last)
    }

    /// An unknown word, with a new symbol.
    pub fn unknown(&mut self) -> Value {
        Value {
            base: Some((self.fresh(), Range::constant(0))),
            ..Value::ANY
        }
    }

    /// The symbol of the extension of `of` plus `offset`; the same one each time.
    pub(crate) fn extension(&mut self, op: ExtendOp, of: Symbol, offset: u32) -> Symbol {
        if let Some(known) = self.extensions.get(&(op, of, offset)) {
            return *known;
        }
        let symbol = self.fresh();
        self.extensions.insert((op, of, offset), symbol);
        symbol
    }

    /// A new symbol with this definition.
    pub fn define(&mut self, definition: Definition) -> Symbol {
        let symbol = self.fresh();
        self.definitions.insert(symbol, definition);
        symbol
    }

    /// The static variable from whose address `value` was computed, if that is known.
    ///
    /// Pointer arithmetic stays within the object by the rules of the language, so `value`
    /// lies in this variable if it is used as an address.
    #[must_use]
    pub fn origin(&self, value: &Value) -> Option<Extent> {
        match self.source(value) {
            Source::Variable(variable) => Some(variable),
            Source::Difference | Source::Unknown => None,
        }
    }

    /// The bytes that an access with an unknown index may reach, where `value` is the sum of
    /// that index and the constant address of an array element. They are the array.
    ///
    /// The compiler may have folded a constant part of the index into the address, which can
    /// move the element into a neighbour of the indexed array. If the element is less than
    /// `FOLDED` bytes from the begin of its array, that array is the indexed one. Otherwise
    /// `FOLDED` bytes to both sides of the element are added.
    #[must_use]
    pub fn indexed(&self, value: &Value) -> Option<Extent> {
        let (symbol, offset) = value.base?;
        if self.sources.contains_key(&symbol) {
            return None;
        }
        let mut elements = self.elements_at(symbol, offset);
        let (element, None) = (elements.next()?, elements.next()) else {
            return None;
        };
        let variable = self.variable(element)?;
        let array = self.variables.array(element).unwrap_or(variable);
        if element - array.first < FOLDED {
            return Some(array);
        }
        Some(array.hull(Extent::new(element - FOLDED, element + FOLDED)))
    }

    /// Array elements at the sum of a symbol and `offset`. They follow from the known sums of
    /// the symbol and a constant address, moved by the distance between the offsets.
    fn elements_at(&self, symbol: Symbol, offset: Range) -> impl Iterator<Item = u32> {
        let sums = self.indices.get(&symbol).into_iter().flatten();
        sums.filter_map(move |&Indexed { sum, element }| {
            let variable = self.variable(element)?;
            let (low, high) = offset.subtract(Range::constant(sum)).signed();
            let size = i64::from(variable.span());
            let near = i64::from(low).abs().max(i64::from(high).abs()) <= size;
            near.then(|| {
                let moved = element.wrapping_add_signed(low);
                moved.clamp(variable.first, variable.last)
            })
        })
    }

    /// The static variable that holds `address`. A variable in a flash that begins at zero is none: an offset or
    /// a count may look like its address, and no store goes there.
    fn variable(&self, address: u32) -> Option<Extent> {
        let variable = self.variables.around(address);
        variable.filter(|variable| variable.first >= NO_NUMBER)
    }

    fn source(&self, value: &Value) -> Source {
        let around = |range: Range| {
            let variable = self.variable(range.start())?;
            let last = range.start().checked_add(range.span())?;
            (last <= variable.last).then_some(Source::Variable(variable))
        };
        let named = |(symbol, offset): (Symbol, Range)| match self.sources.get(&symbol) {
            Some(&Source::Variable(variable)) => {
                // An offset larger than the variable is a distance to another variable.
                let (low, high) = offset.signed();
                let size = i64::from(variable.span());
                (i64::from(low).abs().max(i64::from(high).abs()) <= size)
                    .then_some(Source::Variable(variable))
            }
            Some(other) => Some(*other),
            None => {
                let mut elements = self.elements_at(symbol, offset);
                let variable = self.variable(elements.next()?)?;
                elements
                    .all(|at| self.variable(at) == Some(variable))
                    .then_some(Source::Variable(variable))
            }
        };
        around(value.range)
            .or_else(|| value.base.and_then(named))
            .unwrap_or(Source::Unknown)
    }

    /// A new symbol for a word that is one of `from`, on different paths. If all of them lie
    /// in one variable, so does it.
    pub fn fresh_within(&mut self, from: &[&Value]) -> Symbol {
        let mut sources = from.iter().map(|value| self.source(value));
        let source = sources.next().unwrap_or(Source::Unknown);
        let source = sources.fold(source, |a, b| match (a, b) {
            _ if a == b => a,
            (Source::Difference, _) | (_, Source::Difference) => Source::Difference,
            _ => Source::Unknown,
        });
        self.fresh_from(source)
    }

    fn fresh_from(&mut self, source: Source) -> Symbol {
        let symbol = self.fresh();
        if source != Source::Unknown {
            self.sources.insert(symbol, source);
        }
        symbol
    }

    /// Notes the source of `result`, the sum of `from` and `by` (or an address that was
    /// aligned). An address in a variable plus a distance lies in that variable too.
    pub fn moved(&mut self, result: Value, from: &Value, by: &Value) -> Value {
        let source = match (self.source(from), self.source(by)) {
            (Source::Difference, _) | (_, Source::Difference) => Source::Difference,
            (variable, Source::Unknown) | (Source::Unknown, variable) => variable,
            _ => Source::Unknown,
        };
        let element = [from, by].map(|value| value.as_constant());
        if let (Source::Variable(_), [Some(element), None] | [None, Some(element)]) =
            (source, element)
            && let Some((symbol, offset)) = result.base
        {
            let sums = self.indices.entry(symbol).or_default();
            let known = Indexed {
                sum: offset.start(),
                element,
            };
            if !sums.contains(&known) {
                sums.push(known);
            }
        }
        self.with_source(result, source)
    }

    /// Notes the source of `result`, which is `from` less `by`.
    pub fn moved_down(&mut self, result: Value, from: &Value, by: &Value) -> Value {
        let source = match (self.source(from), self.source(by)) {
            (source, Source::Unknown) => source,
            _ => Source::Difference,
        };
        self.with_source(result, source)
    }

    fn with_source(&mut self, mut result: Value, source: Source) -> Value {
        if result.as_constant().is_none() && result.base.is_none() && source != Source::Unknown {
            result.base = Some((self.fresh_from(source), Range::constant(0)));
        }
        result
    }

    /// The definition of `value`, if it is a symbol itself and that has one.
    #[must_use]
    pub fn definition(&self, value: &Value) -> Option<&Definition> {
        match value.base {
            Some((symbol, offset)) if offset.as_constant() == Some(0) => {
                self.definitions.get(&symbol)
            }
            _ => None,
        }
    }

    /// Every word that `value` may be, if they are known individually.
    #[must_use]
    pub fn elements(&self, value: &Value) -> Option<Vec<u32>> {
        if let Some(word) = value.as_constant() {
            return Some(vec![word]);
        }
        let (symbol, offset) = value.base?;
        let offset = offset.as_constant()?;
        match self.definitions.get(&symbol)? {
            Definition::OneOf(words) => Some(
                words
                    .iter()
                    .map(|word| word.wrapping_add(offset))
                    .filter(|word| value.range.contains(*word))
                    .collect(),
            ),
            _ => None,
        }
    }

    /// Every address that `value` may be if it is used as one, if they are known individually. By the rules of the
    /// language nothing is read or written through a pointer that may be null while it is.
    #[must_use]
    pub fn targets(&self, value: &Value) -> Option<Vec<u32>> {
        let mut all = self.elements(value)?;
        let pointer = value.base.filter(|(symbol, _)| self.may_be_null(*symbol));
        let from_null = pointer.and_then(|(_, offset)| offset.as_constant());
        if all.len() > 1 {
            all.retain(|at| Some(*at) != from_null);
        }
        Some(all)
    }

    /// Whether a symbol is null or one of a few addresses. Zero may also be the first of some indices: small numbers,
    /// and addresses in a memory that begins at zero look like those.
    fn may_be_null(&self, symbol: Symbol) -> bool {
        match self.definitions.get(&symbol) {
            Some(Definition::OneOf(words)) => words.iter().all(|at| *at == 0 || *at >= NO_NUMBER),
            _ => false,
        }
    }

    /// A value that is one of `words`.
    pub fn one_of(&mut self, mut words: Vec<u32>) -> Option<Value> {
        words.sort_unstable();
        words.dedup();
        let range = words
            .iter()
            .map(|word| Range::constant(*word))
            .reduce(Range::join)?;
        let base = if words.len() > 1 && words.len() <= MAX_ELEMENTS {
            Some((self.define(Definition::OneOf(words)), Range::constant(0)))
        } else {
            None
        };
        Some(Value {
            range,
            base,
            stack: false,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pointer_that_is_used_is_not_null() {
        let mut symbols = Symbols::default();
        let few = symbols.one_of(vec![0, 0x2000_0010, 0x0800_0020]).unwrap();
        let fourth = few.add(&Value::constant(16));
        assert_eq!(symbols.elements(&few).map(|all| all.len()), Some(3));
        assert_eq!(symbols.targets(&few), Some(vec![0x0800_0020, 0x2000_0010]));
        assert_eq!(
            symbols.targets(&fourth),
            Some(vec![0x0800_0030, 0x2000_0020])
        );
        // An index, and the begin of a memory.
        let index = symbols.one_of(vec![0, 4, 8]).unwrap();
        let element = index.add(&Value::constant(0x1000));
        assert_eq!(
            symbols.targets(&element),
            Some(vec![0x1000, 0x1004, 0x1008])
        );
        let constant = Value::constant(16);
        assert_eq!(symbols.targets(&constant), Some(vec![16]));
    }

    use crate::lasting::reach;

    /// `value` plus a constant, as an instruction adds it.
    fn plus(symbols: &mut Symbols, value: &Value, constant: u32) -> Value {
        let by = Value::constant(constant);
        symbols.moved(value.add(&by), value, &by)
    }

    /// The vector table of a part whose flash begins at zero lies at 64, and so does a field of many a structure.
    #[test]
    fn a_small_number_is_no_address_of_a_variable() {
        let mut symbols = Symbols::new(&Variables::of_sizes(&[(64, 192), (0x2000_0000, 192)]));
        let pointer = symbols.unknown();
        let field = plus(&mut symbols, &pointer, 79);
        assert_eq!(symbols.origin(&field), None);
        assert_eq!(symbols.origin(&pointer), None);
        assert_eq!(reach(&symbols, &field, 4), Some(Extent::EVERYWHERE));
        let index = symbols.unknown();
        let element = plus(&mut symbols, &index, 0x2000_000f);
        let variable = Extent::new(0x2000_0000, 0x2000_00bf);
        assert_eq!(symbols.origin(&element), Some(variable));
        assert_eq!(reach(&symbols, &element, 4), Some(variable));
    }
}
