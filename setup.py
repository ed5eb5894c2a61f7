"""The packages of the wheel: three trees, found on disk so that none can be forgotten.

    spiral/ -> spiral        plugins/ -> spiral_plugins        conf/ -> spiral_conf

``pyproject.toml`` holds everything else; only this mapping of names cannot be written there.
"""

from setuptools import find_packages, setup

TREES = {"spiral": "spiral", "plugins": "spiral_plugins", "conf": "spiral_conf"}

setup(
    packages=[
        package.replace(folder, name, 1)
        for folder, name in TREES.items()
        for package in find_packages(include=[folder, f"{folder}.*"])
    ],
    package_dir={name: folder for folder, name in TREES.items()},
)
