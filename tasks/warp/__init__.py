"""MuJoCo Warp: MuJoCo's physics of many robots at once, in single precision, for a GPU."""
