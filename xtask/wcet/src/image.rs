//! A linked image: code, constants, symbols and line tables.

use std::cell::RefCell;
use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

use object::{Object, ObjectSection, ObjectSymbol, SectionFlags, SymbolKind};
use sha2::{Digest, Sha256};

use super::extent::Extent;
use super::signatures::Signature;

/// Why a file cannot be used as an image.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ImageError {
    /// The file cannot be read.
    #[error("cannot read {path}: {reason}")]
    Unreadable {
        /// The file.
        path: String,
        /// The reason that the system or the parser gives.
        reason: String,
    },
    /// Not a little-endian 32-bit Arm ELF file.
    #[error("{path} is not an Arm ELF image (build it for thumbv6m, thumbv7m or thumbv7em)")]
    NotArm {
        /// The file.
        path: String,
    },
}

/// Exception number of the non-maskable interrupt, the first behind the reset (DDI 0403 B1.5.2).
pub const NMI: u16 = 2;
/// Exception number of the hard fault.
pub const HARD_FAULT: u16 = 3;
/// Exception number of the last fault. All numbers from [`NMI`] to it are faults, or not used.
pub const LAST_FAULT: u16 = 7;
/// Exception number of the first interrupt of the part.
pub const FIRST_INTERRUPT: u16 = 16;
/// Symbol of the handler of every vector to which the program gives none.
pub const DEFAULT_HANDLER: &str = "DefaultHandler";
/// The most interrupts that the core can have.
const MOST_INTERRUPTS: u32 = 496;

/// A function of the image.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Function {
    /// Demangled name, without the hash.
    pub name: String,
    /// Linker name.
    pub symbol: String,
    /// Size in bytes; zero if the symbol has none.
    pub size: u32,
}

/// A source line.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Place {
    /// File as the compiler recorded it.
    pub file: String,
    /// Line, counted from one; zero if it is unknown.
    pub line: u32,
}

impl std::fmt::Display for Place {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}:{}", short(&self.file), self.line)
    }
}

/// A path without the folder of the registry, the toolchain's library or the workspace, so
/// that reports do not depend on the machine.
fn short(file: &str) -> &str {
    for mark in ["/library/", "/registry/src/"] {
        if let Some(at) = file.find(mark) {
            let rest = &file[at + mark.len()..];
            return match mark {
                "/registry/src/" => rest.split_once('/').map_or(rest, |(_, tail)| tail),
                _ => rest,
            };
        }
    }
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/");
    let workspace = root.trim_end_matches("xtask/wcet/");
    file.strip_prefix(workspace).unwrap_or(file)
}

/// The static variables of an image.
#[derive(Debug, Clone, Default)]
pub struct Variables {
    /// Size by address.
    sizes: BTreeMap<u32, u32>,
    /// Demangled name by address.
    names: BTreeMap<u32, String>,
    arrays: Vec<Extent>,
}

impl Variables {
    /// Variables without names or arrays, by address and size.
    #[cfg(test)]
    pub(crate) fn of_sizes(sizes: &[(u32, u32)]) -> Self {
        Self {
            sizes: sizes.iter().copied().collect(),
            ..Self::default()
        }
    }

    /// The variable that holds `address`.
    #[must_use]
    pub fn around(&self, address: u32) -> Option<Extent> {
        let (start, size) = self.sizes.range(..=address).next_back()?;
        (address - start < *size).then(|| Extent::new(*start, start + size - 1))
    }

    /// Everything with an index that the program may compute: the arrays, or all variables if none is known. The
    /// room of a software task's future is an array by its type only; nobody computes an index into it.
    pub fn indexable(&self) -> impl Iterator<Item = Extent> {
        let all = self.sizes.iter().filter(|(_, size)| **size > 0);
        let whole = all.map(|(start, size)| Extent::new(*start, start + (size - 1)));
        let whole = whole.filter(|_| self.arrays.is_empty());
        let arrays = self.arrays.iter().copied().chain(whole);
        arrays.filter(|array| !self.is_of_a_future(array.first))
    }

    /// Whether RTIC keeps the future of a software task at `address`.
    fn is_of_a_future(&self, address: u32) -> bool {
        let first = self.around(address).map(|variable| variable.first);
        let name = first.and_then(|first| self.names.get(&first));
        name.is_some_and(|name| name.contains("::__rtic_internal_") && name.ends_with("_EXEC"))
    }

    /// The array that holds `address`, if one does.
    #[must_use]
    pub fn array(&self, address: u32) -> Option<Extent> {
        let arrays = self.arrays.iter().copied();
        // In a union several arrays may hold the address; any of them may be meant.
        let holding = arrays.filter(|array| array.contains(address));
        holding.reduce(Extent::hull)
    }
}

/// A linked image.
pub struct Image {
    constants: Vec<(u32, Vec<u8>)>,
    code: Vec<(u32, u32)>,
    data_in_code: Vec<(u32, u32)>,
    functions: BTreeMap<u32, Function>,
    symbols: BTreeMap<String, u32>,
    lines: Option<addr2line::Loader>,
    load: Vec<(u32, Vec<u8>)>,
    /// The variables that begin as zeros.
    zeroed: Option<Extent>,
    variables: Variables,
    signatures: BTreeMap<u32, Signature>,
    /// Folder that messages leave out of the paths in it.
    root: Option<PathBuf>,
    known_places: RefCell<HashMap<u32, Vec<Place>>>,
    /// Digests of sources, by their names in places.
    digests: RefCell<HashMap<String, Option<[u8; 32]>>>,
}

impl std::fmt::Debug for Image {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Image")
            .field("functions", &self.functions.len())
            .finish_non_exhaustive()
    }
}

impl Image {
    /// Reads the ELF file at `path`.
    ///
    /// # Errors
    /// When it cannot be read or is for another machine.
    pub fn read(path: &Path) -> Result<Self, ImageError> {
        let unreadable = |reason: String| ImageError::Unreadable {
            path: path.display().to_string(),
            reason,
        };
        let bytes = std::fs::read(path).map_err(|error| unreadable(error.to_string()))?;
        let file = object::File::parse(&*bytes).map_err(|error| unreadable(error.to_string()))?;
        if file.architecture() != object::Architecture::Arm || !file.is_little_endian() {
            return Err(ImageError::NotArm {
                path: path.display().to_string(),
            });
        }
        let mut image = Self {
            constants: Vec::new(),
            code: Vec::new(),
            data_in_code: Vec::new(),
            functions: BTreeMap::new(),
            symbols: BTreeMap::new(),
            lines: addr2line::Loader::new(path).ok(),
            load: Vec::new(),
            zeroed: None,
            variables: Variables::default(),
            signatures: BTreeMap::new(),
            root: None,
            known_places: RefCell::new(HashMap::new()),
            digests: RefCell::default(),
        };
        for section in file.sections() {
            if section.name() == Ok(".bss") && section.size() > 0 {
                let first = section.address() as u32;
                image.zeroed = Some(Extent::new(first, first + (section.size() as u32 - 1)));
            }
            let SectionFlags::Elf { sh_flags, .. } = section.flags() else {
                continue;
            };
            let allocated = sh_flags.contains(object::elf::SHF_ALLOC);
            let writable = sh_flags.contains(object::elf::SHF_WRITE);
            let executable = sh_flags.contains(object::elf::SHF_EXECINSTR);
            let Ok(data) = section.data() else { continue };
            if !allocated || data.is_empty() {
                continue;
            }
            let address = section.address() as u32;
            image.load.push((address, data.to_vec()));
            if !writable {
                image.constants.push((address, data.to_vec()));
            }
            if executable {
                image.code.push((address, address + data.len() as u32));
            }
        }
        image.read_symbols(&file);
        image.variables.arrays = super::arrays::of(&file);
        image.signatures = super::signatures::of(&file);
        Ok(image)
    }

    /// The same image, with paths of sources in the folder `root` relative to it.
    #[must_use]
    pub fn relative_to(self, root: &Path) -> Self {
        Self {
            root: Some(root.to_owned()),
            known_places: RefCell::default(),
            digests: RefCell::default(),
            ..self
        }
    }

    fn read_symbols(&mut self, file: &object::File<'_>) {
        let mut marks: BTreeMap<u32, bool> = BTreeMap::new();
        for symbol in file.symbols() {
            let Ok(name) = symbol.name() else { continue };
            let address = symbol.address() as u32;
            match name.split('.').next() {
                Some("$t") => {
                    marks.insert(address, false);
                    continue;
                }
                Some("$d") => {
                    marks.entry(address).or_insert(true);
                    continue;
                }
                _ => {}
            }
            if symbol.is_definition() || symbol.address() != 0 {
                self.symbols.insert(name.to_owned(), address & !1);
            }
            if symbol.kind() == SymbolKind::Data && symbol.size() > 0 {
                let size = self.variables.sizes.entry(address).or_default();
                *size = (*size).max(symbol.size() as u32);
                let names = &mut self.variables.names;
                names.entry(address).or_insert_with(|| readable(name));
            }
            if symbol.kind() == SymbolKind::Text && self.is_code(address & !1) {
                let function = Function {
                    name: readable(name),
                    symbol: name.to_owned(),
                    size: symbol.size() as u32,
                };
                // If an address has several names, a global one is shown. The default handler also
                // has the names of all vectors that lead to it.
                let known = self.functions.get(&(address & !1));
                let stays = known
                    .is_some_and(|known| known.symbol == DEFAULT_HANDLER || !symbol.is_global());
                if !stays {
                    self.functions.insert(address & !1, function);
                }
            }
        }
        for &(start, end) in &self.code {
            let mut data_from = None;
            for (&address, &is_data) in marks.range(start..end) {
                match (is_data, data_from) {
                    (true, None) => data_from = Some(address),
                    (false, Some(from)) => {
                        self.data_in_code.push((from, address));
                        data_from = None;
                    }
                    _ => {}
                }
            }
            if let Some(from) = data_from {
                self.data_in_code.push((from, end));
            }
        }
    }

    /// Whether `address` is in code, and not in data among code.
    #[must_use]
    pub fn is_code(&self, address: u32) -> bool {
        self.code
            .iter()
            .any(|&(start, end)| (start..end).contains(&address))
            && !self
                .data_in_code
                .iter()
                .any(|&(start, end)| (start..end).contains(&address))
    }

    /// `address` and the end of the data around it, if it is data among code.
    #[must_use]
    pub fn table_end(&self, address: u32) -> Option<(u32, u32)> {
        self.data_in_code
            .iter()
            .find(|(start, end)| (*start..*end).contains(&address))
            .map(|&(_, end)| (address, end))
    }

    /// The word, halfword or byte (`size` 4, 2, 1) at `address`, if it is a constant of the
    /// image.
    #[must_use]
    pub fn constant(&self, address: u32, size: u32) -> Option<u32> {
        let (start, data) = self.constants.iter().find(|(start, data)| {
            address >= *start
                && u64::from(address) + u64::from(size) <= u64::from(*start) + data.len() as u64
        })?;
        let at = (address - start) as usize;
        let mut word = [0; 4];
        word[..size as usize].copy_from_slice(&data[at..at + size as usize]);
        Some(u32::from_le_bytes(word))
    }

    /// What is never written: address and bytes.
    pub(crate) fn constants(&self) -> impl Iterator<Item = (u32, &[u8])> {
        let constants = self.constants.iter();
        constants.map(|(address, data)| (*address, &data[..]))
    }

    /// The static variables.
    #[must_use]
    pub fn variables(&self) -> &Variables {
        &self.variables
    }

    /// The variables that begin as zeros: `cortex-m-rt` fills them in front of the program.
    #[must_use]
    pub(crate) const fn zeroed(&self) -> Option<Extent> {
        self.zeroed
    }

    /// Initial words of the initialised static variables: address and word.
    pub fn initial_words(&self) -> impl Iterator<Item = (u32, u32)> {
        let constant = |address: u32| self.constants.iter().any(|(start, _)| *start == address);
        let writable = self.load.iter().filter(move |(start, _)| !constant(*start));
        writable.flat_map(|(start, data)| {
            let words = data.chunks_exact(4).zip((*start..).step_by(4));
            words.map(|(word, at)| (at, u32::from_le_bytes([word[0], word[1], word[2], word[3]])))
        })
    }

    /// Address of the vector table of `cortex-m-rt`, if the image has one.
    #[must_use]
    pub fn vector_table(&self) -> Option<u32> {
        self.symbol("__RESET_VECTOR").map(|reset| reset - 4)
    }

    /// The vectors behind the reset that lead to code, by exception number: address of the handler
    /// of each.
    #[must_use]
    pub fn vectors(&self) -> BTreeMap<u16, u32> {
        let vectors = self.used_vectors();
        vectors.filter(|(_, at)| self.is_code(*at)).collect()
    }

    /// The vectors behind the reset that are in use and lead to no code of the image, by exception
    /// number: the address to which each leads.
    #[must_use]
    pub fn stray_vectors(&self) -> BTreeMap<u16, u32> {
        let vectors = self.used_vectors();
        vectors.filter(|(_, at)| !self.is_code(*at)).collect()
    }

    /// The vectors behind the reset that are not zero: exception number and address.
    fn used_vectors(&self) -> impl Iterator<Item = (u16, u32)> {
        let interrupts = self.symbol("__INTERRUPTS").map_or(0, |first| {
            let end = self.symbols.values().filter(|at| **at > first).min();
            end.map_or(0, |end| (end - first) / 4)
        });
        let last = FIRST_INTERRUPT + interrupts.min(MOST_INTERRUPTS) as u16;
        let table = self.vector_table().into_iter();
        let words = table.flat_map(move |table| {
            let word = move |number: u16| self.constant(table + 4 * u32::from(number), 4);
            (NMI..last).filter_map(move |number| Some((number, word(number)?)))
        });
        let used = words.filter(|(_, word)| *word != 0);
        used.map(|(number, word)| (number, word & !1))
    }

    /// Handlers in the vector table that may return to the interrupted code: those of all
    /// interrupts and of the exceptions that are no faults.
    #[must_use]
    pub fn handlers(&self) -> Vec<u32> {
        let vectors = self.vectors().into_iter();
        let mut handlers: Vec<u32> = vectors
            .filter(|(number, _)| *number > LAST_FAULT)
            .map(|(_, at)| at)
            .collect();
        handlers.sort_unstable();
        handlers.dedup();
        handlers
    }

    /// The symbols of the functions at `address`.
    pub fn symbols_at(&self, address: u32) -> impl Iterator<Item = &str> {
        let symbols = self.symbols.iter();
        let here = symbols.filter(move |(_, at)| **at == address);
        here.map(|(name, _)| name.as_str())
    }

    /// The halfword of code at `address`.
    #[must_use]
    pub fn halfword(&self, address: u32) -> Option<u16> {
        self.constant(address, 2).map(|half| half as u16)
    }

    /// The function that begins at `address`.
    #[must_use]
    pub fn function(&self, address: u32) -> Option<&Function> {
        self.functions.get(&address)
    }

    /// What the debug information says of the function that begins at `address`.
    pub(crate) fn signature(&self, address: u32) -> Option<Signature> {
        self.signatures.get(&address).copied()
    }

    /// The function that holds `address` and where it begins.
    #[must_use]
    pub fn enclosing(&self, address: u32) -> Option<(u32, &Function)> {
        let (start, function) = self.functions.range(..=address).next_back()?;
        (function.size == 0 || address < start + function.size).then_some((*start, function))
    }

    /// Every function by its address.
    pub fn functions(&self) -> impl Iterator<Item = (u32, &Function)> {
        self.functions.iter().map(|(address, f)| (*address, f))
    }

    /// Address of a linker symbol, with the Thumb bit cleared.
    #[must_use]
    pub fn symbol(&self, name: &str) -> Option<u32> {
        self.symbols.get(name).copied()
    }

    /// Every linker symbol.
    pub fn symbols(&self) -> impl Iterator<Item = &str> {
        self.symbols.keys().map(String::as_str)
    }

    /// Name of the function at or around `address`.
    #[must_use]
    pub fn name(&self, address: u32) -> String {
        self.enclosing(address)
            .map_or_else(|| format!("{address:#010x}"), |(_, f)| f.name.clone())
    }

    /// Name of the variable that holds `address`, and the distance from its begin in bytes.
    #[must_use]
    pub fn variable(&self, address: u32) -> Option<(&str, u32)> {
        let start = self.variables.around(address)?.first;
        let name = self.variables.names.get(&start)?;
        Some((name, address - start))
    }

    /// Source lines of `address`, that of the innermost inlined function first.
    #[must_use]
    pub fn places(&self, address: u32) -> Vec<Place> {
        let mut known = self.known_places.borrow_mut();
        known
            .entry(address)
            .or_insert_with(|| self.find_places(address))
            .clone()
    }

    fn find_places(&self, address: u32) -> Vec<Place> {
        let mut places = Vec::new();
        let Some(lines) = &self.lines else {
            return places;
        };
        let Ok(mut frames) = lines.find_frames(u64::from(address)) else {
            return places;
        };
        while let Ok(Some(frame)) = frames.next() {
            if let Some(location) = frame.location
                && let Some(file) = location.file
            {
                let root = self.root.as_deref();
                let inside = root.and_then(|root| Path::new(file).strip_prefix(root).ok());
                let inside = inside.and_then(Path::to_str);
                places.push(Place {
                    file: inside.unwrap_or(file).to_owned(),
                    line: location.line.unwrap_or(0),
                });
            }
        }
        places
    }

    /// The SHA-256 digest of a source, which is named as [`Image::places`] has it; `None` if it cannot be read
    /// here.
    pub(crate) fn digest(&self, file: &str) -> Option<[u8; 32]> {
        let mut digests = self.digests.borrow_mut();
        let known = digests.entry(file.to_owned()).or_insert_with(|| {
            let path = self.root.as_deref().unwrap_or(Path::new("")).join(file);
            let text = std::fs::read(path).ok()?;
            Some(Sha256::digest(text).into())
        });
        *known
    }

    /// A description of `address` for messages: its innermost line in this workspace, else its
    /// innermost line, and the function.
    #[must_use]
    pub fn describe(&self, address: u32) -> String {
        let places = self.places(address);
        let own = places
            .iter()
            .find(|place| {
                !["/rustc/", "/registry/", "/library/"]
                    .iter()
                    .any(|folder| place.file.contains(folder))
            })
            .or(places.first());
        match own {
            Some(place) => format!("{place} ({})", self.name(address)),
            None => format!("{} at {address:#010x}", self.name(address)),
        }
    }

    /// Contents of the sections that are loaded before the image runs: address and bytes.
    pub fn contents(&self) -> impl Iterator<Item = (u32, &[u8])> {
        self.load
            .iter()
            .map(|(address, data)| (*address, &data[..]))
    }
}

fn readable(symbol: &str) -> String {
    format!("{:#}", rustc_demangle::demangle(symbol))
}
