//! The debug information of an image, unit by unit.

use addr2line::gimli::{self, Dwarf, EndianSlice, LittleEndian, Unit};
use object::{Object, ObjectSection};

/// Bytes of the debug information.
pub(crate) type Slice<'a> = EndianSlice<'a, LittleEndian>;

/// Calls `see` with each unit that can be read.
pub(crate) fn each_unit<'a>(
    file: &'a object::File<'_>,
    mut see: impl FnMut(&Dwarf<Slice<'a>>, &Unit<Slice<'a>>),
) {
    let section = |id: gimli::SectionId| -> Result<Slice<'a>, gimli::Error> {
        let data = file.section_by_name(id.name());
        let data = data.and_then(|section| section.data().ok());
        Ok(EndianSlice::new(data.unwrap_or_default(), LittleEndian))
    };
    let Ok(dwarf) = Dwarf::load(section) else {
        return;
    };
    let mut units = dwarf.units();
    while let Ok(Some(header)) = units.next() {
        if let Ok(unit) = dwarf.unit(header) {
            see(&dwarf, &unit);
        }
    }
}
