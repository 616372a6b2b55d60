from setuptools import find_packages, setup

NAME = "tms_bag"

setup(
    name=NAME,
    version="0.1.0",
    packages=find_packages(),
    package_data={NAME: ["py.typed", "definitions/*/msg/*.msg", "logs/mappings/*.yaml", "nodes/*.xml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    python_requires=">=3.10,<3.14",
    install_requires=[
        "setuptools",
        "lz4>=4",
        "mcap>=1.6",
        "numpy>=1.26",
        "PyYAML>=6",
        "rosbags>=0.10",
        "tqdm>=4.66",
        "zstandard>=0.22",
    ],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="TMS maintainers",
    maintainer_email="maintainers@example.org",
    description="Recordings as rosbag2 MCAP bags: read, write, import CSV, repair; recorder and player.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "recorder = tms_bag.nodes.executables:recorder",
            "player = tms_bag.nodes.executables:player",
        ]
    },
)
