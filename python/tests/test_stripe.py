"""Stripes from arrays: results, layouts, stacks, out=, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import bell
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import uwscan
from uwscan import _uwscan

#: Error of a centre without noise but rounding, px.
NOISELESS_PX = 0.02
#: A fitted background is off by what a stripe's far flanks leave, DN.
BACKGROUND_DN = 3
METHODS = ["fast", "robust", "precise", "ridge", "cog", "blais-rioux"]


def same(a: uwscan.Stripe, b: uwscan.Stripe, pick=...) -> None:
    for name in ["position_px", "sigma_px", "amplitude", "width_px", "background", "chi2", "rival_ratio", "flags", "reject"]:
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name)[pick], err_msg=name)


@pytest.mark.parametrize("method", METHODS)
def test_every_method_finds_the_centre(method):
    stripe = uwscan.extract_stripe(bell(), method=method)
    assert stripe.position_px.shape == (64,) and stripe.position_px.dtype == np.float32
    assert stripe.flags.dtype == np.uint16 and stripe.shape == [64] and stripe.axis == "rows"
    assert np.max(np.abs(stripe.position_px - 40.25)) < NOISELESS_PX


def test_columns_are_rows_of_the_transposed_image():
    image = bell(slope=0.1)
    rows = uwscan.extract_stripe(image, method="precise")
    columns = uwscan.extract_stripe(np.ascontiguousarray(image.T), axis="columns", method="precise")
    assert columns.axis == "columns"
    same(rows, columns)


def test_sixteen_bits_and_full_scale():
    wide = bell().astype(np.uint16) * 16
    stripe = uwscan.extract_stripe(wide, full_scale_dn=4095)
    assert np.max(np.abs(stripe.position_px - 40.25)) < NOISELESS_PX
    clipped = np.minimum(wide, 1500)
    known = uwscan.extract_stripe(clipped, full_scale_dn=1500, method="precise")
    assert np.all(known.flags & uwscan.StripeFlags.SATURATED)


@pytest.mark.parametrize(
    "layout",
    [
        lambda a: np.asfortranarray(a),
        lambda a: np.repeat(a, 2, axis=0)[::2],
        lambda a: np.repeat(a, 2, axis=1)[:, ::2],
        lambda a: np.pad(a, 7)[7:-7, 7:-7],
        lambda a: a[::-1].copy()[::-1],
        lambda a: a[:, ::-1].copy()[:, ::-1],
        lambda a: np.lib.stride_tricks.as_strided(a, a.shape, a.strides, writeable=False),
    ],
)
def test_any_layout_gives_the_same(layout):
    image = bell(slope=0.1)
    same(uwscan.extract_stripe(image), uwscan.extract_stripe(layout(image)))


def test_a_row_repeated_by_broadcasting_is_read():
    image = np.broadcast_to(bell()[0], (64, 96))
    same(uwscan.extract_stripe(bell()), uwscan.extract_stripe(image))


def test_unaligned_pixels_are_read():
    image = bell().astype(np.uint16)
    raw = np.zeros(image.nbytes + 1, np.uint8)
    odd = raw[1:].view(np.uint16).reshape(image.shape)
    odd[:] = image
    assert not odd.flags.aligned
    same(uwscan.extract_stripe(image), uwscan.extract_stripe(odd))


@pytest.mark.parametrize("threads", [1, 2])
def test_a_stack_is_its_images(threads):
    stack = np.stack([bell(at=20 + 5 * k) for k in range(6)])
    noise = uwscan.NoiseModel(40, 1)
    settings = {"noise": noise, "sigma_px": 2.0}
    stripes = uwscan.extract_stripe(stack, threads=threads, **settings)
    assert stripes.position_px.shape == (6, 64) and stripes.shape == [6, 64]
    for k, image in enumerate(stack):
        same(uwscan.extract_stripe(image, **settings), stripes, k)


def test_a_stack_of_none_has_no_results():
    stripes = uwscan.extract_stripe(np.zeros((0, 8, 9), np.uint8))
    assert stripes.position_px.shape == (0, 8)


def test_calls_do_not_learn_from_each_other():
    first = uwscan.extract_stripe(bell(sigma=2.0))
    uwscan.extract_stripe(bell(sigma=4.0))
    same(first, uwscan.extract_stripe(bell(sigma=2.0)))


def test_out_is_filled_anew_under_the_views_of_it():
    stripe = uwscan.extract_stripe(bell(at=30))
    position = stripe.position_px
    again = uwscan.extract_stripe(bell(at=50), out=stripe)
    assert again is stripe
    assert np.max(np.abs(position - 50)) < NOISELESS_PX
    with pytest.raises(uwscan.InputError, match="out must be a Stripe of shape"):
        uwscan.extract_stripe(bell(height=32), out=stripe)
    with pytest.raises(uwscan.InputError, match="same axis"):
        uwscan.extract_stripe(bell(width=64), axis="columns", out=stripe)


def test_region_background_and_threshold():
    stripe = uwscan.extract_stripe(bell(), roi=(20, 8, 60, 16))
    found = np.isfinite(stripe.position_px)
    assert found[8:24].all() and found.sum() == 16
    assert set(stripe.reject[~found]) == {uwscan.StripeReject.OUTSIDE_ROI}
    dark = np.full((64, 96), 10, np.uint8)
    under = np.median(uwscan.extract_stripe(bell(), background=dark).background)
    assert abs(np.median(uwscan.extract_stripe(bell()).background) - under - 10) < BACKGROUND_DN
    dim = np.random.default_rng(1).normal(20, 3, (64, 96)).astype(np.uint8)
    nothing = uwscan.extract_stripe(dim, threshold=50)
    assert np.isnan(nothing.position_px).all()
    assert np.all(nothing.reject > 0)


def test_codes_are_the_librarys():
    flags, reasons = _uwscan.stripe_codes()
    assert flags == {f.name: f.value for f in uwscan.StripeFlags if f.value}
    assert reasons == {r.name: r.value for r in uwscan.StripeReject if r.value}


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((8, 8), np.float32),
        np.zeros((8, 8), np.int16),
        np.zeros((8, 8), bool),
        np.zeros((8, 8), object),
        np.zeros((8, 8), ">u2"),
        np.zeros((8, 8), "S1"),
        [[1, 2], [3, 4]],
        None,
        "image.png",
    ],
)
def test_other_types_are_refused(image):
    with pytest.raises(uwscan.DtypeError, match="uint8") as e:
        uwscan.extract_stripe(image)
    assert isinstance(e.value, (ValueError, TypeError, uwscan.UwscanError))


@pytest.mark.parametrize("shape", [(), (8,), (0, 8), (8, 0), (2, 3, 4, 5), (3, 0, 4)])
def test_other_shapes_are_refused(shape):
    with pytest.raises(uwscan.InputError):
        uwscan.extract_stripe(np.zeros(shape, np.uint8))


@pytest.mark.parametrize(
    "settings",
    [
        {"axis": "diagonal"},
        {"method": "best"},
        {"sigma_px": -1.0},
        {"sigma_px": float("nan")},
        {"threshold": 0.0},
        {"roi": (0, 0, 1000, 5)},
        {"roi": (0, 0, 0, 5)},
        {"full_scale_dn": 0.0},
        {"threads": 0},
        {"background": np.zeros((3, 3), np.uint8)},
        {"background": np.zeros((64, 96), np.uint16)},
    ],
)
def test_settings_out_of_range_are_refused(settings):
    with pytest.raises(uwscan.InputError):
        uwscan.extract_stripe(np.stack([bell(), bell()]), **settings)


@given(
    hnp.arrays(
        st.sampled_from([np.uint8, np.uint16]), hnp.array_shapes(min_dims=2, max_dims=3, max_side=24), elements=st.integers(0, 255)
    ),
    st.sampled_from(METHODS),
    st.sampled_from(["rows", "columns"]),
    st.integers(0, 2),
)
def test_no_image_breaks_it(image, method, axis, flips):
    view = image[..., ::-1] if flips == 1 else image[..., ::2, :] if flips == 2 else image
    stripe = uwscan.extract_stripe(view, method=method, axis=axis)
    lines = view.shape[-2 if axis == "rows" else -1]
    assert stripe.position_px.shape == (*view.shape[:-2], lines)
    np.testing.assert_array_equal(np.isnan(stripe.position_px), stripe.reject > 0)
    limit = view.shape[-1 if axis == "rows" else -2]
    kept = stripe.position_px[np.isfinite(stripe.position_px)]
    assert np.all((kept >= -0.5) & (kept <= limit - 0.5))
    assert np.all(stripe.sigma_px[np.isfinite(stripe.position_px)] > 0)


def test_noise_from_flat_fields():
    rng = np.random.default_rng(5)
    gain, read = 8.0, 1.5
    level = np.linspace(20, 220, 400 * 300).reshape(300, 400)
    exposures = [
        np.clip(np.rint(rng.poisson(s * level * gain, (6, 300, 400)) / gain + rng.normal(0, read, (6, 300, 400))), 0, 255).astype(np.uint8)
        for s in (0.0, 0.3, 1.0)
    ]
    noise = uwscan.NoiseModel.from_flat_fields(exposures[1:])
    assert abs(noise.gain_e_per_dn - gain) < 5 * noise.sigma_gain_e_per_dn < gain / 10
    assert noise.full_scale_dn == 255
    single = uwscan.NoiseModel.from_flat_fields(exposures[2])
    assert abs(single.gain_e_per_dn - gain) < 5 * single.sigma_gain_e_per_dn
    assert uwscan.NoiseModel(40, 1).sigma_gain_e_per_dn is None


@pytest.mark.parametrize("images", [[], np.zeros((1, 8, 8), np.uint8), [np.zeros((8, 8), np.uint8)], 5, [np.zeros((2, 8, 8))]])
def test_flat_fields_that_tell_nothing_are_refused(images):
    with pytest.raises(uwscan.InputError):
        uwscan.NoiseModel.from_flat_fields(images)


@pytest.mark.parametrize("values", [(0, 1), (-1, 1), (40, -1), (float("nan"), 1), (40, 1, -1), (40, 1, 0, 0)])
def test_noise_that_there_can_not_be_is_refused(values):
    with pytest.raises(uwscan.InputError):
        uwscan.NoiseModel(*values)
