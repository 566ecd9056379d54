//! Point clouds and robust shape fits with covariance.
