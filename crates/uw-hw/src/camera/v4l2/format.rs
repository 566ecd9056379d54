//! Which of a device's formats serves, and grey values out of it.

use std::io;

use moq_v4l::{
    FourCC,
    format::{FieldOrder, Format},
};

use crate::{Fault, Pixels};

/// How a device packs pixels, of which only the grey value is taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Packing {
    /// The kernel's name of it, without the blanks that fill it up to four characters.
    pub name: &'static str,
    code: [u8; 4],
    /// Bits of a grey value that count, right-justified; those above eight come as two bytes, the lower first.
    bits: u8,
    /// The byte of a row that holds the first grey value.
    first: usize,
    /// Bytes from one grey value to the next.
    step: usize,
}

/// Those whose grey values are as the sensor or the converter gave them, before those that share a pixel with colour.
const PACKINGS: [Packing; 7] = [
    Packing { name: "GREY", code: *b"GREY", bits: 8, first: 0, step: 1 },
    Packing { name: "YUYV", code: *b"YUYV", bits: 8, first: 0, step: 2 },
    Packing { name: "UYVY", code: *b"UYVY", bits: 8, first: 1, step: 2 },
    Packing { name: "Y10", code: *b"Y10 ", bits: 10, first: 0, step: 2 },
    Packing { name: "Y12", code: *b"Y12 ", bits: 12, first: 0, step: 2 },
    Packing { name: "Y14", code: *b"Y14 ", bits: 14, first: 0, step: 2 },
    Packing { name: "Y16", code: *b"Y16 ", bits: 16, first: 0, step: 2 },
];

/// The packings that serve for values of so many bits, the best first; only the one of that name where it is given.
///
/// # Errors
/// [`Fault::Unsupported`] where there is none.
pub(super) fn packings(device: &str, bits: u8, name: Option<&str>) -> Result<Vec<Packing>, Fault> {
    let known = |of: &dyn Fn(&&Packing) -> bool| PACKINGS.iter().filter(of).copied().collect::<Vec<_>>();
    let names = |of: &[Packing]| of.iter().map(|packing| packing.name).collect::<Vec<_>>().join(", ");
    let fit = known(&|packing| packing.bits == bits);
    let named = known(&|packing| packing.bits == bits && name.is_none_or(|name| packing.name == name));
    match (name, named.is_empty()) {
        (_, false) => Ok(named),
        (Some(name), true) if !fit.is_empty() => Err(Fault::Unsupported {
            device: device.to_owned(),
            what: format!("read {name} as values of {bits} bits"),
            mend: format!("write one of {} as pixel_format, or leave it out", names(&fit)),
        }),
        _ => Err(Fault::Unsupported {
            device: device.to_owned(),
            what: format!("deliver values of {bits} bits"),
            mend: "V4L2 has 8, 10, 12, 14 and 16".into(),
        }),
    }
}

/// Which rows of what comes make the image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Rows {
    All,
    /// Those of the top field, from the first on: the other field was exposed at another time, half a row lower.
    TopField,
}

/// How images come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Taking {
    pub packing: Packing,
    pub size: [u32; 2],
    /// Bytes from one row that comes to the next.
    stride: usize,
    rows: Rows,
}

/// Sets a device up for images of `size`: whole ones, or else top fields of that size. `set` asks the device, and gives what it then does.
///
/// # Errors
/// The device's [`Fault`]; [`Fault::Unsupported`] or [`Fault::FrameSize`] for what it can't do.
pub(super) fn negotiate(
    device: &str,
    size: [u32; 2],
    packings: &[Packing],
    mut set: impl FnMut(&Format) -> io::Result<Format>,
) -> Result<Taking, Fault> {
    let [width, height] = size;
    let ways = [
        (height, FieldOrder::Progressive, Rows::All),
        (height, FieldOrder::Top, Rows::All),
        (height.saturating_mul(2), FieldOrder::Interlaced, Rows::TopField),
    ];
    let (mut instead, mut interlaced) = (None, false);
    for (rows_asked, field, rows) in ways {
        for packing in packings {
            let mut format = Format::new(width, rows_asked, FourCC::new(&packing.code));
            format.field_order = field;
            let got = set(&format).map_err(|e| Fault::Refused {
                device: device.to_owned(),
                doing: format!("{} of {width} x {rows_asked} pixels", packing.name),
                reason: e.to_string(),
            })?;
            let packed = got.fourcc == format.fourcc;
            let sized = packed && [got.width, got.height] == [width, rows_asked];
            if sized && same_field(field, got.field_order) {
                let least = packing.step * width as usize;
                // Drivers that fill nothing in have no gaps between rows.
                let stride = (got.stride as usize).max(least);
                return Ok(Taking { packing: *packing, size, stride, rows });
            }
            interlaced |= sized && rows_asked == height && two_fields(got.field_order);
            instead.get_or_insert((packed, [got.width, got.height], got.fourcc.to_string()));
        }
    }
    let device = device.to_owned();
    Err(match instead {
        _ if interlaced => Fault::Unsupported {
            device,
            what: format!(
                "deliver whole images of {width} x {height} pixels: it interlaces fields that were exposed one after the other"
            ),
            mend: format!(
                "ask for {} rows, in the rig file too, with pixels of twice the height: then the top fields alone are taken",
                height / 2
            ),
        },
        Some((true, got, _)) => Fault::FrameSize { device, needed: size, got },
        other => Fault::Unsupported {
            device,
            what: format!(
                "deliver {}{}",
                packings.iter().map(|packing| packing.name).collect::<Vec<_>>().join(" or "),
                other
                    .map(|(_, _, code)| format!(": it gives {} instead", code.trim_end()))
                    .unwrap_or_default()
            ),
            mend: "give bits and pixel_format that `v4l2-ctl --list-formats-ext` shows".into(),
        },
    })
}

fn same_field(asked: FieldOrder, got: FieldOrder) -> bool {
    match asked {
        FieldOrder::Interlaced => {
            matches!(got, FieldOrder::Interlaced | FieldOrder::InterlacedTB | FieldOrder::InterlacedBT)
        }
        _ => asked as u32 == got as u32,
    }
}

/// Whether an image holds two fields.
fn two_fields(order: FieldOrder) -> bool {
    !matches!(order, FieldOrder::Any | FieldOrder::Progressive | FieldOrder::Top | FieldOrder::Bottom)
}

impl Taking {
    /// The grey values of an image, row by row without gaps.
    ///
    /// # Errors
    /// What is missing of it, in words.
    pub fn grey(&self, bytes: &[u8]) -> Result<Pixels, String> {
        let Packing { bits, first, step, .. } = self.packing;
        let [width, height] = self.size.map(|side| side as usize);
        let apart = match self.rows {
            Rows::All => self.stride,
            Rows::TopField => 2 * self.stride,
        };
        let needed = apart * height.saturating_sub(1) + step * width;
        if bytes.len() < needed {
            return Err(format!("{} bytes came, {needed} are needed", bytes.len()));
        }
        let rows = (0..height).map(|row| &bytes[row * apart..row * apart + step * width]);
        Ok(match (bits, step) {
            (..=8, 1) => rows.flatten().copied().collect::<Vec<u8>>().into(),
            (..=8, _) => {
                let values = rows.flat_map(|row| row[first..].iter().step_by(step));
                values.copied().collect::<Vec<u8>>().into()
            }
            _ => {
                let values = rows.flat_map(|row| row.chunks_exact(2));
                values.map(|two| u16::from_le_bytes([two[0], two[1]])).collect::<Vec<u16>>().into()
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: [u32; 2] = [4, 2];

    /// A device that gives what it can, as drivers do: another size or packing instead of an error.
    fn device(
        code: &'static [u8; 4],
        rows: u32,
        field: FieldOrder,
    ) -> impl FnMut(&Format) -> io::Result<Format> {
        move |asked| {
            let mut got = Format::new(SIZE[0], rows, FourCC::new(code));
            (got.field_order, got.stride) = (field, asked.stride);
            Ok(got)
        }
    }

    fn taking(code: &'static [u8; 4], rows: u32, field: FieldOrder) -> Result<Taking, Fault> {
        negotiate("grabber", SIZE, &packings("grabber", 8, None)?, device(code, rows, field))
    }

    #[test]
    fn whole_images_of_a_packing_that_fits_are_taken() {
        for (code, bytes) in
            [(b"GREY", [1, 2, 3, 4, 5, 6, 7, 8].to_vec()), (b"YUYV", (1..=8).flat_map(|y| [y, 99]).collect())]
        {
            let taking = taking(code, 2, FieldOrder::Progressive).unwrap();
            assert_eq!(taking.packing.name.as_bytes(), code);
            assert_eq!(taking.grey(&bytes), Ok(vec![1_u8, 2, 3, 4, 5, 6, 7, 8].into()));
            let short = taking.grey(&bytes[..bytes.len() - 1]).unwrap_err();
            assert!(short.contains(&format!("{} are needed", bytes.len())), "{short}");
        }
        let taking = taking(b"UYVY", 2, FieldOrder::Progressive).unwrap();
        let bytes: Vec<u8> = (1..=8).flat_map(|y| [99, y]).collect();
        assert_eq!(taking.grey(&bytes), Ok(vec![1_u8, 2, 3, 4, 5, 6, 7, 8].into()));
    }

    #[test]
    fn gaps_between_rows_and_two_bytes_a_value_are_read() {
        let wide = |asked: &Format| {
            let mut got = *asked;
            got.stride = 10;
            Ok(got)
        };
        let taking = negotiate("grabber", SIZE, &packings("grabber", 12, None).unwrap(), wide).unwrap();
        assert_eq!(taking.packing.name, "Y12");
        let bytes = [1, 1, 2, 1, 3, 1, 4, 1, 99, 99, 5, 1, 6, 1, 7, 1, 255, 15];
        assert_eq!(taking.grey(&bytes), Ok(vec![257_u16, 258, 259, 260, 261, 262, 263, 4095].into()));
    }

    #[test]
    fn of_interlaced_images_the_top_field_is_taken_where_that_was_asked_for() {
        let both = taking(b"GREY", 4, FieldOrder::InterlacedTB).unwrap();
        let bytes: Vec<u8> = (0..16).collect();
        assert_eq!(both.grey(&bytes), Ok(vec![0_u8, 1, 2, 3, 8, 9, 10, 11].into()));
        let top = taking(b"GREY", 2, FieldOrder::Top).unwrap();
        assert_eq!(top.grey(&bytes[..8]), Ok(vec![0_u8, 1, 2, 3, 4, 5, 6, 7].into()));
    }

    #[test]
    fn what_a_device_does_instead_is_told_with_what_to_do() {
        let interlaced = taking(b"GREY", 2, FieldOrder::Interlaced).unwrap_err().to_string();
        assert!(
            interlaced.contains("interlaces fields") && interlaced.contains("ask for 1 rows"),
            "{interlaced}"
        );
        let size = taking(b"GREY", 3, FieldOrder::Progressive).unwrap_err();
        let wanted = Fault::FrameSize { device: "grabber".into(), needed: SIZE, got: [4, 3] };
        assert_eq!(size, wanted);
        let colour = taking(b"MJPG", 2, FieldOrder::Progressive).unwrap_err().to_string();
        assert!(colour.contains("GREY or YUYV or UYVY: it gives MJPG instead"), "{colour}");
        let refused = negotiate("grabber", SIZE, &PACKINGS[..1], |_| Err(io::Error::from_raw_os_error(16)));
        assert!(matches!(refused, Err(Fault::Refused { .. })), "{refused:?}");
    }

    #[test]
    fn names_and_bits_that_go_together_with_none_are_refused() {
        let names = |bits, name| {
            packings("grabber", bits, name).map(|all| all.iter().map(|one| one.name).collect::<Vec<_>>())
        };
        assert_eq!(names(8, None), Ok(vec!["GREY", "YUYV", "UYVY"]));
        assert_eq!(names(16, Some("Y16")), Ok(vec!["Y16"]));
        let other = names(8, Some("Y16")).unwrap_err().to_string();
        assert!(
            other.contains("read Y16 as values of 8 bits") && other.contains("GREY, YUYV, UYVY"),
            "{other}"
        );
        assert!(names(9, None).unwrap_err().to_string().contains("values of 9 bits"));
    }
}
