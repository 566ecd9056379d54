"""What the numbers in `Stripe.flags` and `Stripe.reject` mean."""

from __future__ import annotations

import enum

__all__ = ["StripeFlags", "StripeReject"]


class StripeFlags(enum.IntFlag):
    """What is noteworthy about a measurement; a flagged one still counts.

    Examples
    --------
    >>> import uwscan
    >>> uwscan.StripeFlags(5)
    <StripeFlags.SATURATED|EDGE: 5>
    """

    NONE = 0
    #: Clipped pixels in the window.
    SATURATED = 1
    #: A second stripe-like peak on the line; `rival_ratio` says how strong.
    SEVERAL_PEAKS = 2
    #: An edge of brightness crosses the stripe; the centre may be off by more than `sigma_px`.
    EDGE = 4
    #: The refinement used up its iterations.
    NOT_CONVERGED = 8
    #: The window was cut by the border of the image or region.
    BORDER = 16
    #: The residuals are larger than noise explains; `sigma_px` was widened.
    POOR_FIT = 32
    #: The stripe was not where the last image had it.
    TRACK_LOST = 64


class StripeReject(enum.IntEnum):
    """Why a line has no position."""

    #: It has one.
    NONE = 0
    OUTSIDE_ROI = 1
    #: Nothing stands out of the noise.
    NO_SIGNAL = 2
    #: Something stands out, but less than `threshold`.
    BELOW_THRESHOLD = 3
    TOO_WIDE = 4
    #: Narrower than any lens would draw it: a hot pixel.
    TOO_NARROW = 5
    AT_BORDER = 6
    #: Clipped so far that the flanks no longer fix the centre.
    SATURATED = 7
    #: Where the light falls off at the end of a run; or an edge, with `reject_edges`.
    EDGE = 8
    #: No neighbours along the stripe agree with it.
    INCONSISTENT = 9
    NOT_CONVERGED = 10
    #: The predicted sigma is too large.
    IMPRECISE = 11
    #: Another stripe lies too near.
    MERGED = 12
    #: The line cuts a bend of the stripe too steeply.
    BENT = 13
