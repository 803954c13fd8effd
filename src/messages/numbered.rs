//! Numbers of enumerations on the wire: each has a value `Other`, which stands for all numbers of later versions.

/// Implements the conversions of an enumeration with a list `ALL` to its number on the wire and back. A number that is
/// not of the list becomes `Other`, whose own number is 255.
macro_rules! numbered {
    ($($of:ty),*) => {
        $(impl From<$of> for u8 {
            fn from(value: $of) -> u8 {
                value as u8
            }
        }

        impl From<u8> for $of {
            fn from(number: u8) -> $of {
                <$of>::ALL.get(usize::from(number)).copied().unwrap_or(<$of>::Other)
            }
        })*
    };
}

pub(super) use numbered;

#[cfg(test)]
mod tests {
    use super::super::aloft::Flight;
    use super::super::hardware::Health;
    use super::super::phase::Phase;
    use super::super::place::{PlaceAnswer, Whereabouts};
    use super::super::status::Hindrance;

    #[test]
    fn a_number_means_what_was_converted_to_it_and_one_of_a_later_version_is_other() {
        macro_rules! check {
            ($($of:ty),*) => {
                $(for number in 0..=u8::MAX {
                    let known = usize::from(number) < <$of>::ALL.len();
                    assert_eq!(u8::from(<$of>::from(number)), if known { number } else { u8::MAX });
                })*
            };
        }
        check!(Flight, Health, Hindrance, Phase, PlaceAnswer, Whereabouts);
    }
}
