//! Images of 8 or 16 bits, grey or colour, as one channel.

use std::{borrow::Cow, fs, io::Cursor, path::Path};

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{DynamicImage, ExtendedColorType, ImageEncoder, ImageError, ImageFormat, ImageReader};

use crate::error::{Error, SaidBy};

/// How colour becomes one channel. Grey images are taken as they are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Reduce {
    /// Rec. 709 luma: for images of the target.
    Luma,
    /// The channel nearest this wavelength, in nanometres: for images of the stripe, whose light the other channels
    /// see as noise.
    Wavelength(f64),
}

/// The pixels, row by row.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Pixels {
    /// From a file of up to 8 bits.
    U8(Vec<u8>),
    /// From a file of 9 to 16 bits.
    U16(Vec<u16>),
}

impl Pixels {
    /// How many values there are.
    pub fn len(&self) -> usize {
        match self {
            Self::U8(values) => values.len(),
            Self::U16(values) => values.len(),
        }
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// A grey image. Pixel (0, 0) is the top-left one; pixel (u, v) is at `v * width + u`, without padding.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GrayImage {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// The values.
    pub data: Pixels,
    /// The largest value that a pixel can have, which a saturated one has.
    pub full_scale: u16,
}

/// A format of image files that is kept as it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum FileFormat {
    Png,
    Jpeg,
}

impl FileFormat {
    /// The format of a file's bytes; `None` where it is another.
    pub fn of_bytes(bytes: &[u8]) -> Option<Self> {
        if bytes.starts_with(b"\x89PNG\r\n\x1a\n") {
            Some(Self::Png)
        } else {
            bytes.starts_with(b"\xff\xd8").then_some(Self::Jpeg)
        }
    }
}

/// An image as it is stored.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Stored {
    /// The bytes of a file.
    File { format: FileFormat, bytes: Vec<u8> },
    /// Values.
    Grey(GrayImage),
}

/// What is known of a camera's images before one is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Expect {
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// Significant bits, 1 to 16.
    pub bits: u8,
    /// What says so.
    pub said_by: SaidBy,
}

impl Expect {
    /// What a rig's camera makes, as a rig file or a calibration says it.
    pub fn of(camera: &crate::rig::Camera, said_by: SaidBy) -> Self {
        Self { size: [camera.width, camera.height], bits: camera.bits, said_by }
    }
}

/// The largest image that is decoded: 1 GiB of values, so that a lie in a header costs an error and not the memory.
const MOST_BYTES: u64 = 1 << 30;

/// The image in a file, in one channel, held against what is known of its camera where that is given. One call decodes one
/// image on the thread that calls.
///
/// # Errors
/// [`Error::File`] where it cannot be read, [`Error::Image`] where it cannot be decoded or has values above the
/// camera's bits, [`Error::ImageSize`] where its size is another than the camera's.
pub fn read(path: &Path, reduce: Reduce, expect: Option<Expect>) -> Result<GrayImage, Error> {
    let bytes = fs::read(path).map_err(Error::file(path, "read the image"))?;
    decode(&bytes, path, reduce, expect)
}

/// The bytes of a PNG file with this image, 8 or 16 bits deep.
///
/// # Errors
/// [`Error::Image`] where the values are not as many as its size says; `path` names it.
pub fn encode_png(image: &GrayImage, path: &Path) -> Result<Vec<u8>, Error> {
    let (raw, color): (Cow<'_, [u8]>, _) = match &image.data {
        Pixels::U8(values) => (Cow::Borrowed(values), ExtendedColorType::L8),
        // The encoder takes the machine's order.
        Pixels::U16(values) => {
            (values.iter().flat_map(|v| v.to_ne_bytes()).collect(), ExtendedColorType::L16)
        }
    };
    let mut bytes = Vec::new();
    // Stripes on black compress well with the quickest setting.
    let encoder = PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Up);
    if image.data.len() != image.width as usize * image.height as usize {
        let what =
            format!("{} values are no image of {} x {} px", image.data.len(), image.width, image.height);
        return Err(Error::image(path, what, "report this: it is a fault of the program"));
    }
    let written = encoder.write_image(&raw, image.width, image.height, color);
    written.map_err(|e| {
        Error::image(path, format!("cannot be encoded: {e}"), "report this: it is a fault of the program")
    })?;
    Ok(bytes)
}

/// The image in `bytes`, as [`read`]; `path` names it in errors.
///
/// # Errors
/// As [`read`].
pub fn decode(bytes: &[u8], path: &Path, reduce: Reduce, expect: Option<Expect>) -> Result<GrayImage, Error> {
    if bytes.is_empty() {
        return Err(Error::image(path, "is an empty file", "copy it again from where it was recorded"));
    }
    if bytes.starts_with(b"\xff\xd8") && !jpeg_ends(bytes) {
        return Err(damaged(path, "the JPEG data end too early"));
    }
    let mut gray = reduced(dynamic(bytes, path)?, reduce).ok_or_else(|| no_integers(path))?;
    if let Some(largest) = portable_maximum(bytes) {
        gray.unscale(largest);
    }
    match expect {
        Some(expect) => hold_against(gray, path, expect),
        None => Ok(gray),
    }
}

fn dynamic(bytes: &[u8], path: &Path) -> Result<DynamicImage, Error> {
    let mut reader =
        ImageReader::new(Cursor::new(bytes)).with_guessed_format().map_err(Error::file(path, "read"))?;
    let mut limits = image::Limits::default();
    limits.max_alloc = Some(MOST_BYTES);
    reader.limits(limits);
    reader.decode().map_err(|e| decode_error(path, e))
}

fn no_integers(path: &Path) -> Error {
    let what = "its pixels are neither 8- nor 16-bit integers";
    Error::image(path, what, "save it as 8- or 16-bit PNG or TIFF")
}

/// The image in a file as it can be stored elsewhere without loss: the bytes of a PNG or JPEG, else a PNG of the same values.
///
/// # Errors
/// As [`read`].
pub(crate) fn stored(path: &Path) -> Result<Stored, Error> {
    let bytes = fs::read(path).map_err(Error::file(path, "read the image"))?;
    if let Some(format) = FileFormat::of_bytes(&bytes) {
        return Ok(Stored::File { format, bytes });
    }
    let image = match dynamic(&bytes, path)? {
        DynamicImage::ImageLuma8(_) | DynamicImage::ImageLuma16(_) => {
            return decode(&bytes, path, Reduce::Luma, None).map(Stored::Grey);
        }
        image => image,
    };
    let scaled = portable_maximum(&bytes).is_some_and(|largest| ![0xff, 0xffff].contains(&largest));
    let integers = image.color().bytes_per_pixel() / image.color().channel_count() <= 2;
    if scaled || !integers {
        return Err(no_integers(path));
    }
    let mut png = Cursor::new(Vec::new());
    image.write_to(&mut png, ImageFormat::Png).map_err(|_| no_integers(path))?;
    Ok(Stored::File { format: FileFormat::Png, bytes: png.into_inner() })
}

/// The bytes of an image file in a format that keeps every value.
///
/// # Errors
/// [`Error::Image`] where the format can't hold the image, or what is stored can't be decoded.
pub(crate) fn encoded(image: Stored, format: ImageFormat, path: &Path) -> Result<Vec<u8>, Error> {
    let refused = |e: ImageError| Error::image(path, format!("cannot be written: {e}"), "name it .png");
    let mut file = Cursor::new(Vec::new());
    match image {
        Stored::File { format: FileFormat::Png, bytes } if format == ImageFormat::Png => return Ok(bytes),
        Stored::File { format: FileFormat::Jpeg, bytes } if format == ImageFormat::Jpeg => return Ok(bytes),
        Stored::File { bytes, .. } => dynamic(&bytes, path)?.write_to(&mut file, format).map_err(refused)?,
        Stored::Grey(GrayImage { width, height, data, .. }) => {
            let image = match data {
                Pixels::U8(values) => {
                    GrayBuffer::from_raw(width, height, values).map(DynamicImage::ImageLuma8)
                }
                Pixels::U16(values) => {
                    Gray16Buffer::from_raw(width, height, values).map(DynamicImage::ImageLuma16)
                }
            };
            image.ok_or_else(|| no_integers(path))?.write_to(&mut file, format).map_err(refused)?;
        }
    }
    Ok(file.into_inner())
}

type GrayBuffer = image::ImageBuffer<image::Luma<u8>, Vec<u8>>;
type Gray16Buffer = image::ImageBuffer<image::Luma<u16>, Vec<u16>>;

fn reduced(image: DynamicImage, reduce: Reduce) -> Option<GrayImage> {
    let (width, height) = (image.width(), image.height());
    let (data, full_scale) = match image {
        DynamicImage::ImageLuma8(i) => (Pixels::U8(i.into_raw()), 0xff),
        DynamicImage::ImageLuma16(i) => (Pixels::U16(i.into_raw()), 0xffff),
        DynamicImage::ImageLumaA8(i) => (Pixels::U8(pick(&i, 2, 0)), 0xff),
        DynamicImage::ImageLumaA16(i) => (Pixels::U16(pick(&i, 2, 0)), 0xffff),
        i @ (DynamicImage::ImageRgb8(_) | DynamicImage::ImageRgba8(_)) => match reduce {
            Reduce::Luma => (Pixels::U8(i.into_luma8().into_raw()), 0xff),
            Reduce::Wavelength(nm) => {
                let channels = usize::from(i.color().channel_count());
                (Pixels::U8(pick(i.as_bytes(), channels, channel(nm))), 0xff)
            }
        },
        i @ (DynamicImage::ImageRgb16(_) | DynamicImage::ImageRgba16(_)) => match (reduce, &i) {
            (Reduce::Wavelength(nm), DynamicImage::ImageRgb16(b)) => {
                (Pixels::U16(pick(b, 3, channel(nm))), 0xffff)
            }
            (Reduce::Wavelength(nm), DynamicImage::ImageRgba16(b)) => {
                (Pixels::U16(pick(b, 4, channel(nm))), 0xffff)
            }
            _ => (Pixels::U16(i.into_luma16().into_raw()), 0xffff),
        },
        _ => return None,
    };
    Some(GrayImage { width, height, data, full_scale })
}

impl GrayImage {
    /// Undoes the decoder's scaling of a portable map's values from 0..=`largest` to the whole range of their type.
    fn unscale(&mut self, largest: u16) {
        let from = u32::from(self.full_scale);
        let to = u32::from(largest);
        if to >= from {
            return;
        }
        let back = |value: u32| (value * to + from / 2) / from;
        match &mut self.data {
            Pixels::U8(values) => values.iter_mut().for_each(|v| *v = back(u32::from(*v)) as u8),
            Pixels::U16(values) => values.iter_mut().for_each(|v| *v = back(u32::from(*v)) as u16),
        }
        self.full_scale = largest;
    }
}

/// The largest value that a portable grey or colour map declares; `None` for every other format.
fn portable_maximum(bytes: &[u8]) -> Option<u16> {
    let (magic, rest) = bytes.split_at_checked(2)?;
    let token = match magic {
        b"P2" | b"P3" | b"P5" | b"P6" => 2,
        b"P7" => {
            let at = rest.windows(6).position(|w| w == b"MAXVAL")?;
            return header_tokens(&rest[at + 6..]).next();
        }
        _ => return None,
    };
    header_tokens(rest).nth(token)
}

/// The numbers of a portable map's header; comments run from # to the end of their line.
fn header_tokens(bytes: &[u8]) -> impl Iterator<Item = u16> {
    let mut comment = false;
    let uncommented = move |b: &u8| {
        comment = *b == b'#' || comment && *b != b'\n';
        if comment { b' ' } else { *b }
    };
    // Headers are short, and pixels follow them.
    let head: Vec<u8> = bytes.iter().take(1 << 12).map(uncommented).collect();
    let words: Vec<u16> = head
        .split(u8::is_ascii_whitespace)
        .filter(|w| !w.is_empty())
        .map_while(|w| std::str::from_utf8(w).ok()?.parse().ok())
        .take(3)
        .collect();
    words.into_iter()
}

fn pick<T: Copy>(values: &[T], channels: usize, channel: usize) -> Vec<T> {
    values.iter().skip(channel).step_by(channels).copied().collect()
}

/// The channel, of red, green and blue, whose filter lets a wavelength through best: the filters of a Bayer sensor
/// peak near 610, 535 and 460 nm.
fn channel(wavelength_nm: f64) -> usize {
    if wavelength_nm > 0.5 * (610.0 + 535.0) {
        0
    } else if wavelength_nm > 0.5 * (535.0 + 460.0) {
        1
    } else {
        2
    }
}

/// The image, if it is what its camera makes.
pub(crate) fn hold_against(mut image: GrayImage, path: &Path, expect: Expect) -> Result<GrayImage, Error> {
    let got = [image.width, image.height];
    if got != expect.size {
        return Err(Error::ImageSize {
            path: path.to_owned(),
            needed: expect.size,
            got,
            said_by: expect.said_by,
        });
    }
    let full_scale = (u32::MAX >> (32 - u32::from(expect.bits.clamp(1, 16)))) as u16;
    image.full_scale = image.full_scale.min(full_scale);
    let largest = match &image.data {
        Pixels::U8(_) if full_scale >= 0xff => 0,
        Pixels::U8(values) => values.iter().copied().max().map_or(0, u16::from),
        Pixels::U16(values) => values.iter().copied().max().unwrap_or(0),
    };
    if largest > full_scale {
        let what = format!("has a value of {largest}, but {} bits end at {full_scale}", expect.bits);
        return Err(Error::image(path, what, expect.said_by.bits()));
    }
    Ok(image)
}

/// Whether a JPEG's last scan is closed: the decoder fills a torn one up with grey.
fn jpeg_ends(bytes: &[u8]) -> bool {
    let marker = |code: u8| bytes.windows(2).rposition(|w| w == [0xff, code]);
    // The start of the last scan, not of a preview's in the header; inside a scan 0xff is followed by 0 or a restart.
    matches!((marker(0xda), marker(0xd9)), (Some(start), Some(end)) if end > start)
}

fn damaged(path: &Path, what: impl Into<String>) -> Error {
    Error::image(path, what, "the file is torn or damaged: copy it again from where it was recorded")
}

fn decode_error(path: &Path, e: ImageError) -> Error {
    match e {
        ImageError::Limits(_) => {
            Error::image(path, format!("is too large: {e}"), "images of up to 1 GiB are read; check the file")
        }
        ImageError::Unsupported(_) => {
            Error::image(path, format!("cannot be read: {e}"), "save it as 8- or 16-bit grey PNG or TIFF")
        }
        e => damaged(path, format!("cannot be decoded: {e}")),
    }
}
