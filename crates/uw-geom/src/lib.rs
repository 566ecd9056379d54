//! Frames, refraction at flat windows, camera, laser fan and the scanner's exact model.
