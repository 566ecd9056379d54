use std::{fs, io::Cursor, path::Path};

use image::{DynamicImage, ImageBuffer, ImageFormat, Luma, LumaA, Rgb, Rgba};
use proptest::prelude::*;
use tempfile::TempDir;
use uw_io::{Error, Expect, GrayImage, Pixels, Reduce, SaidBy, images};

use crate::samples::says;

const GREEN: Reduce = Reduce::Wavelength(532.0);

fn encoded(image: &DynamicImage, format: ImageFormat) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    image.write_to(&mut bytes, format).unwrap();
    bytes.into_inner()
}

fn decode(bytes: &[u8], reduce: Reduce, expect: Option<Expect>) -> Result<GrayImage, Error> {
    images::decode(bytes, Path::new("frames/x"), reduce, expect)
}

fn grey8() -> DynamicImage {
    DynamicImage::ImageLuma8(ImageBuffer::from_fn(24, 16, |u, v| Luma([(u * 10 + v) as u8])))
}

fn grey16() -> DynamicImage {
    DynamicImage::ImageLuma16(ImageBuffer::from_fn(24, 16, |u, v| Luma([(u * 170 + v) as u16])))
}

#[test]
fn grey_comes_back_value_by_value() {
    for format in [ImageFormat::Png, ImageFormat::Tiff, ImageFormat::Pnm] {
        for (image, full_scale) in [(grey8(), 255), (grey16(), 65535)] {
            let data = match &image {
                DynamicImage::ImageLuma8(i) => Pixels::U8(i.as_raw().clone()),
                other => Pixels::U16(other.to_luma16().into_raw()),
            };
            let got = decode(&encoded(&image, format), GREEN, None).unwrap();
            assert_eq!(got, GrayImage { width: 24, height: 16, data, full_scale }, "{format:?}");
        }
    }
    /// JPEG of a smooth ramp at the encoder's quality, grey levels.
    const JPEG_LOSS: u8 = 8;
    let got = decode(&encoded(&grey8(), ImageFormat::Jpeg), GREEN, None).unwrap();
    let Pixels::U8(values) = got.data else { panic!("a JPEG has 8 bits") };
    let worst = values.iter().zip(grey8().as_bytes()).map(|(a, b)| a.abs_diff(*b)).max();
    assert!(worst <= Some(JPEG_LOSS), "{worst:?}");
}

#[test]
fn twelve_bits_in_a_portable_grey_map_stay_as_they_are() {
    for text in [&b"P2 # grey\n3 1 # 12 bits\n4095 0 1000 4095"[..], b"P5 3 1 4095\n\x00\x00\x03\xe8\x0f\xff"]
    {
        let got = decode(text, GREEN, Some(Expect { size: [3, 1], bits: 12, said_by: SaidBy::Rig })).unwrap();
        assert_eq!(
            got,
            GrayImage { width: 3, height: 1, data: Pixels::U16(vec![0, 1000, 4095]), full_scale: 4095 }
        );
    }
    for largest in [1, 3, 100, 254, 256, 1023, 4095, 65534_u16] {
        let values: Vec<u16> = (0..=largest).step_by(usize::from(largest / 200).max(1)).collect();
        let text = format!("P2 {} 1 {largest} {values:?}", values.len()).replace(['[', ']', ','], " ");
        let got = decode(text.as_bytes(), GREEN, None).unwrap();
        let read = match got.data {
            Pixels::U8(v) => v.into_iter().map(u16::from).collect(),
            Pixels::U16(v) => v,
        };
        assert_eq!((read, got.full_scale), (values, largest));
    }
}

#[test]
fn colour_gives_the_lasers_channel_or_luma() {
    let (r, g, b) = (200, 100, 50);
    let eight = [
        DynamicImage::ImageRgb8(ImageBuffer::from_pixel(3, 2, Rgb([r, g, b]))),
        DynamicImage::ImageRgba8(ImageBuffer::from_pixel(3, 2, Rgba([r, g, b, 9]))),
    ];
    let wide = |x: u8| u16::from(x) * 257;
    let sixteen = [
        DynamicImage::ImageRgb16(ImageBuffer::from_pixel(3, 2, Rgb([r, g, b].map(wide)))),
        DynamicImage::ImageRgba16(ImageBuffer::from_pixel(3, 2, Rgba([r, g, b, 9].map(wide)))),
    ];
    // Rec. 709: 0.2126 R + 0.7152 G + 0.0722 B = 117.65; the conversion drops the fraction or rounds.
    for (reduce, values) in [
        (Reduce::Wavelength(650.0), r..=r),
        (Reduce::Wavelength(635.0), r..=r),
        (Reduce::Wavelength(532.0), g..=g),
        (Reduce::Wavelength(520.0), g..=g),
        (Reduce::Wavelength(450.0), b..=b),
        (Reduce::Luma, 117..=118),
    ] {
        for image in &eight {
            let Pixels::U8(got) = decode(&encoded(image, ImageFormat::Png), reduce, None).unwrap().data
            else {
                panic!()
            };
            assert!(got.len() == 6 && got.iter().all(|v| values.contains(v)), "{reduce:?}: {got:?}");
        }
        for image in &sixteen {
            let Pixels::U16(got) = decode(&encoded(image, ImageFormat::Png), reduce, None).unwrap().data
            else {
                panic!()
            };
            assert!(
                got.len() == 6
                    && got.iter().all(|v| (wide(*values.start())..=wide(*values.end())).contains(v)),
                "{got:?}"
            );
        }
    }
    let alpha = DynamicImage::ImageLumaA8(ImageBuffer::from_fn(3, 2, |u, v| LumaA([(3 * v + u) as u8, 77])));
    let got = decode(&encoded(&alpha, ImageFormat::Png), GREEN, None).unwrap();
    assert_eq!(got.data, Pixels::U8(vec![0, 1, 2, 3, 4, 5]));
}

#[test]
fn images_are_held_against_the_rig() {
    let bytes = encoded(&grey16(), ImageFormat::Png);
    let expect = |size, bits| Some(Expect { size, bits, said_by: SaidBy::Rig });
    let fine = decode(&bytes, GREEN, expect([24, 16], 12)).unwrap();
    assert_eq!(fine.full_scale, 4095);
    let error = decode(&bytes, GREEN, expect([16, 24], 12)).unwrap_err();
    assert!(matches!(error, Error::ImageSize { needed: [16, 24], got: [24, 16], .. }));
    says(&error.to_string(), &["frames/x", "24 x 16", "16 x 24", "--rig"]);
    let error = decode(&bytes, GREEN, expect([24, 16], 10)).unwrap_err();
    says(&error.to_string(), &["frames/x", "3925", "10 bits end at 1023", "mend bits in the rig file"]);
    let eight = encoded(&grey8(), ImageFormat::Png);
    assert_eq!(
        decode(&eight, GREEN, expect([24, 16], 12)).unwrap().full_scale,
        255,
        "a file of 8 bits saturates there"
    );
    assert!(decode(&eight, GREEN, expect([24, 16], 7)).is_err());
}

#[test]
fn torn_files_are_named_and_never_filled_up() {
    let colour =
        DynamicImage::ImageRgb8(ImageBuffer::from_fn(64, 48, |u, v| Rgb([(u * v) as u8, u as u8, v as u8])));
    for format in [ImageFormat::Png, ImageFormat::Tiff, ImageFormat::Pnm, ImageFormat::Jpeg] {
        let bytes = encoded(&colour, format);
        for keep in [0, 1, 7, 20, 50, bytes.len() / 2, bytes.len() * 9 / 10] {
            let message = decode(&bytes[..keep.min(bytes.len())], GREEN, None).unwrap_err().to_string();
            says(&message, &["frames/x: "]);
        }
    }
    // A scan that is torn after a preview that is whole.
    let whole = encoded(&colour, ImageFormat::Jpeg);
    let torn = [
        &whole[..2],
        b"\xff\xe1",
        &(whole.len() as u16 + 2).to_be_bytes(),
        &whole,
        &whole[2..whole.len() / 2],
    ]
    .concat();
    says(&decode(&torn, GREEN, None).unwrap_err().to_string(), &["end too early"]);
    for rubbish in [&b"not an image at all"[..], b"GIF89a\x01\0\x01\0", b"\x89PNG\r\n\x1a\n", &[0; 4096]] {
        assert!(matches!(decode(rubbish, GREEN, None), Err(Error::Image { .. })));
    }
}

#[test]
fn a_header_that_lies_about_its_size_costs_no_memory() {
    let lie = decode(b"P5 60000 60000 255\n", GREEN, None).unwrap_err();
    says(&lie.to_string(), &["frames/x", "too large"]);
    assert!(decode(b"P5 99999999999 1 255\n", GREEN, None).is_err());
}

#[test]
fn files_that_cannot_be_read_are_named() {
    let dir = TempDir::new().unwrap();
    for path in [dir.path().join("absent.png"), dir.path().to_owned()] {
        let error = images::read(&path, Reduce::Luma, None).unwrap_err();
        assert!(matches!(error, Error::File { .. }));
        says(&error.to_string(), &[path.to_str().unwrap(), "cannot read the image"]);
    }
    let path = dir.path().join("named after another format.png");
    fs::write(&path, encoded(&grey8(), ImageFormat::Tiff)).unwrap();
    assert_eq!(images::read(&path, GREEN, None).unwrap().width, 24, "what counts is the content");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 256, failure_persistence: None, ..ProptestConfig::default() })]

    /// Whatever happens to a file's bytes, decoding returns: an error, or an image as large as it says.
    #[test]
    fn damage_never_panics(format in 0..4_usize, at in any::<prop::sample::Index>(), to in any::<u8>(), cut in any::<prop::sample::Index>()) {
        let format = [ImageFormat::Png, ImageFormat::Tiff, ImageFormat::Pnm, ImageFormat::Jpeg][format];
        let mut bytes = encoded(&grey8(), format);
        let at = at.index(bytes.len());
        bytes[at] = to;
        bytes.truncate(bytes.len() - cut.index(bytes.len()) / 8);
        if let Ok(image) = decode(&bytes, GREEN, None) {
            let values = match image.data { Pixels::U8(v) => v.len(), Pixels::U16(v) => v.len() };
            prop_assert_eq!(values as u64, u64::from(image.width) * u64::from(image.height));
        }
    }
}
