//! Sub-pixel laser stripe extraction with predicted uncertainty.
