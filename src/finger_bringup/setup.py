"""Build description of finger_bringup (pip and colcon)."""

from glob import glob

from setuptools import find_packages, setup

PACKAGE = "finger_bringup"

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Launch files, rig parameters, trial protocol and operator page of the finger contact suite.",
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
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "finger-rig = finger_bringup.cli:main",
            "unattended_node = finger_bringup.unattended_node:main",
            "bring_up_node = finger_bringup.bring_up_node:main",
            "fit_request_node = finger_bringup.fit_request_node:main",
        ],
    },
)
