"""The dictionaries of markers that a ``[target.NAME]`` may name; its keys are those of a capture set."""

# Markers of each of OpenCV's dictionaries; ``cv2`` itself takes long to import.
DICTIONARY_SIZES = {
    **{f"DICT_{n}X{n}_{size}": size for n in (4, 5, 6, 7) for size in (50, 100, 250, 1000)},
    "DICT_ARUCO_ORIGINAL": 1024,
    **{f"DICT_ARUCO_MIP_36{h}12": 250 for h in "hH"},
    **{f"DICT_APRILTAG_16{h}5": 30 for h in "hH"},
    **{f"DICT_APRILTAG_25{h}9": 35 for h in "hH"},
    **{f"DICT_APRILTAG_36{h}10": 2320 for h in "hH"},
    **{f"DICT_APRILTAG_36{h}11": 587 for h in "hH"},
}
