"""Build description of finger_driver (pip and colcon)."""

from glob import glob

from setuptools import find_packages, setup

PACKAGE = "finger_driver"

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Force, camera and moisture drivers of the finger contact suite, with wire-level device simulators.",
    license="Apache-2.0",
    maintainer="Finger contact suite maintainers",
    maintainer_email="maintainers@finger-contact.example",
    python_requires=">=3.10",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        (f"share/{PACKAGE}/launch", glob("launch/*.py")),
        (f"share/{PACKAGE}/config", glob("config/*")),
    ],
    package_data={PACKAGE: ["data/*", "data/**/*"]},
    zip_safe=True,
    entry_points={
        "console_scripts": [
            "force_node = finger_driver.force_node:main",
            "camera_node = finger_driver.camera_node:main",
            "moisture_node = finger_driver.moisture_node:main",
            "finger-device-sim = finger_driver.simulators.cli:main",
        ],
    },
)
