use crate::find;
use crate::render::{Image, Random, Scene};
use proptest::prelude::*;
use uw_calib::{Chessboard, GreyView, Layout, Rejection, Samples, detect};

fn filled(size: [usize; 2], mut value: impl FnMut(usize, usize) -> u16) -> Image {
    let data = (0..size[1])
        .flat_map(|row| (0..size[0]).map(move |col| (col, row)))
        .map(|(c, r)| value(c, r))
        .collect();
    Image { data, size, levels: 255 }
}

#[test]
fn images_without_a_board_have_none() {
    let mut random = Random(3);
    for (name, image) in [
        ("empty", filled([0, 0], |_, _| 0)),
        ("one pixel", filled([1, 1], |_, _| 9)),
        ("one row", filled([300, 1], |c, _| c as u16)),
        ("black", filled([200, 150], |_, _| 0)),
        ("saturated", filled([200, 150], |_, _| 255)),
        ("slope", filled([200, 150], |c, r| (c / 2 + r) as u16)),
        ("noise", filled([200, 150], |_, _| (random.uniform() * 255.0) as u16)),
        ("stripes", filled([200, 150], |c, _| if c / 10 % 2 == 0 { 30 } else { 200 })),
    ] {
        let found = find(&image, [11, 8]);
        assert!(
            matches!(found, Err(Rejection::NoBoard { .. } | Rejection::TooFew { .. })),
            "{name}: {found:?}"
        );
    }
}

#[test]
fn a_larger_board_is_refused_and_a_smaller_one_is_never_whole() {
    let image = Scene::plain().render();
    assert_eq!(find(&image, [9, 8]), Err(Rejection::Larger { seen: [11, 8], declared: [9, 8] }));
    assert_eq!(find(&image, [11, 7]), Err(Rejection::Larger { seen: [11, 8], declared: [11, 7] }));
    let part = find(&image, [17, 13]).unwrap();
    assert!(!part.full && part.corners.len() == 88);
    // Declared the other way round it is the same board.
    let turned = find(&image, [8, 11]).unwrap();
    assert!(turned.full && turned.seen == [8, 11]);
}

#[test]
fn checks_all_over_the_image_are_a_larger_board() {
    let image = filled([400, 300], |c, r| if (c / 20 + r / 20) % 2 == 0 { 30 } else { 200 });
    assert!(matches!(find(&image, [11, 8]), Err(Rejection::Larger { .. })));
}

#[test]
fn a_padded_slice_is_read_by_its_stride() {
    let scene = Scene::plain();
    let image = scene.render();
    let stride = scene.size[0] + 13;
    let mut data = vec![255_u8; stride * scene.size[1]];
    for (row, line) in image.data.chunks(scene.size[0]).enumerate() {
        for (col, value) in line.iter().enumerate() {
            data[row * stride + col] = *value as u8;
        }
    }
    let layout = Layout { width: scene.size[0], height: scene.size[1], stride };
    let view = GreyView::new(Samples::U8(&data), layout, 255).unwrap();
    let board = Chessboard::new(11, 8, 1.0).unwrap();
    assert_eq!(detect(&view, &board), find(&image, [11, 8]));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, failure_persistence: None, ..ProptestConfig::default() })]

    /// Whatever is in an image, detection comes to an end and never calls less than a whole board whole.
    #[test]
    fn nothing_makes_it_panic(
        width in 0_usize..90, height in 0_usize..90, seed in any::<u64>(), cell in 1_usize..20, spread in 0.0..300.0_f64,
        levels in prop::sample::select(vec![1_u16, 255, 4095, 65535]),
    ) {
        let mut random = Random(seed);
        let mut image = filled([width, height], |c, r| {
            let check = if (c / cell + r / cell) % 2 == 0 { 0.2 } else { 0.8 };
            ((check + spread / 255.0 * random.normal()) * f64::from(levels)).clamp(0.0, f64::from(levels)) as u16
        });
        image.levels = levels;
        if let Ok(detection) = find(&image, [5, 4]) {
            prop_assert!(detection.corners.len() >= 9 && detection.corners.len() <= 20);
            prop_assert!(detection.corners.iter().all(|c| c.index[0] < 5 && c.index[1] < 5 && c.pixel.iter().all(|x| x.is_finite())));
        }
    }
}
