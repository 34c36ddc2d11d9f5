"""What the commands are called, and which module each is."""

# Name -> module below treadlight.commands, in the order of the pipeline.
COMMANDS = {
    "inspect": "inspect_capture",
    "calibrate-camera": "calibrate_camera",
    "calibrate-laser-plane": "calibrate_laser_plane",
    "calibrate-axis": "calibrate_axis",
    "calibrate-leds": "calibrate_leds",
    "calibrate-illumination": "calibrate_illumination",
    "calibrate": "calibrate",
    "detect-laser-pixels": "detect_laser_pixels",
    "triangulate": "triangulate",
    "register-to-cylinder": "register_to_cylinder",
    "photometric-stereo": "photometric_stereo",
    "integrate": "integrate",
    "wear": "wear",
    "report": "report",
    "index": "index",
    "check": "check_capture",
    "export": "export",
    "status": "status",
    "verify": "verify",
    "evaluate": "evaluate",
    "budget": "budget",
    "normals": "normals",
    "simulate": "simulate",
}
