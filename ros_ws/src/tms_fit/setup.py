from setuptools import find_packages, setup

NAME = "tms_fit"

setup(
    name=NAME,
    version="0.1.0",
    packages=find_packages(),
    package_data={NAME: ["py.typed", "report/templates/*.*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", ["launch/replay.launch.py"]),
    ],
    python_requires=">=3.10,<3.14",
    install_requires=[
        "setuptools",
        "filterpy>=2.0,<3",
        "matplotlib>=3.6",
        "numpy>=1.26",
        "scipy>=1.11",
        "tqdm>=4.66",
        "vl-convert-python>=1.6",
    ],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="TMS maintainers",
    maintainer_email="maintainers@example.org",
    description="Strikes, initial lean rate by least squares and Kalman smoothing, Figure 3B.",
    license="Apache-2.0",
    entry_points={"console_scripts": ["estimator = tms_fit.nodes.executables:estimator"]},
)
