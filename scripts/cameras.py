"""A calibration's camera in ROS's and OpenCV's YAML, read by PyYAML and OpenCV: scripts/recordings.sh."""

import sys
import tomllib

import cv2
import numpy as np
import yaml

calibration, ros, opencv = sys.argv[1:]
with open(calibration, "rb") as file:
    camera = tomllib.load(file)["camera"]
lens = [camera[name] for name in ("k1", "k2", "p1", "p2", "k3")]
matrix = np.array([[camera["fx_px"], 0, camera["cx_px"]], [0, camera["fy_px"], camera["cy_px"]], [0, 0, 1]])

with open(ros) as file:
    read = yaml.safe_load(file)
assert read["distortion_model"] == "plumb_bob" and read["distortion_coefficients"]["data"] == lens
assert (np.array(read["camera_matrix"]["data"]).reshape(3, 3) == matrix).all()
assert (np.array(read["projection_matrix"]["data"]).reshape(3, 4)[:, :3] == matrix).all()

read = cv2.FileStorage(opencv, cv2.FILE_STORAGE_READ)
assert (read.getNode("camera_matrix").mat() == matrix).all()
assert (read.getNode("distortion_coefficients").mat() == np.array([lens])).all()
size = [int(read.getNode(f"image_{side}").real()) for side in ("width", "height")]
assert cv2.getOptimalNewCameraMatrix(matrix, np.array(lens), size, 0)[0].shape == (3, 3)
print("PyYAML and OpenCV read the camera")
