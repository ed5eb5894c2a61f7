"""Systems as the fit process describes them to the page: what they record, and in which unit."""

OSCILLATOR = {
    "name": "oscillator",
    "channels": [{"name": "x", "unit": "m"}],
    "inputs": [{"name": "force", "unit": "N", "required": True}],
}
ROTOR = {
    "name": "planar_rotor",
    "channels": [{"name": "x", "unit": "m"}, {"name": "y", "unit": "m"}],
    "inputs": [{"name": "speed", "unit": "rad/s", "required": True}],
}
