from setuptools import find_packages, setup

NAME = "tms_calibrate"

setup(
    name=NAME,
    version="0.1.0",
    packages=find_packages(),
    package_data={NAME: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    python_requires=">=3.10,<3.14",
    install_requires=["setuptools", "matplotlib>=3.6", "numpy>=1.26", "scipy>=1.11"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="TMS maintainers",
    maintainer_email="maintainers@example.org",
    description="Many strikes in one fit: pooled parameters, calibration of a bicycle, identifiability.",
    license="Apache-2.0",
    entry_points={
        "tms.fit": [
            "together = tms_calibrate.commands:TOGETHER",
            "calibrate = tms_calibrate.commands:CALIBRATE",
        ]
    },
)
