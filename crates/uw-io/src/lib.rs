//! Capture folders, rig and calibration files, point cloud formats.
