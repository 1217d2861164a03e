//! Values of a vehicle's manifest that a scenario may change.

/// Defines a struct of changes to another struct, in which every field may be left out.
///
/// Fields after `optional` are optional in the other struct too.
macro_rules! changes {
    (
        $(#[$about:meta])*
        $visible:vis struct $name:ident of $whole:ident {
            $($field:ident: $type:ty,)*
        } optional {
            $($maybe:ident: $maybe_type:ty,)*
        }
    ) => {
        $(#[$about])*
        #[derive(Clone, Debug, Default, PartialEq, serde::Deserialize)]
        #[serde(deny_unknown_fields, default)]
        $visible struct $name {
            $($field: Option<$type>,)*
            $($maybe: Option<$maybe_type>,)*
        }

        impl $name {
            /// Applies the fields that are present.
            pub(crate) fn apply(self, whole: &mut $whole) {
                $(if let Some(value) = self.$field {
                    whole.$field = value;
                })*
                $(if self.$maybe.is_some() {
                    whole.$maybe = self.$maybe;
                })*
            }
        }
    };
}

pub(crate) use changes;
