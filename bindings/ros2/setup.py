from setuptools import setup

NAME = "smr_gpu_ros"

setup(
    name=NAME,
    version="0.1.0",
    description="Finds snap joints in the pictures of a GelSight-like tactile sensor, as a ROS 2 node",
    license="MIT OR Apache-2.0",
    maintainer="The developers of smr-gpu",
    maintainer_email="smr-gpu@example.org",
    packages=[NAME],
    python_requires=">=3.11",
    install_requires=["numpy", "pillow", "smr-gpu"],
    zip_safe=True,
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", ["launch/smr_gpu.launch.xml"]),
        (f"share/{NAME}/config", ["config/fastdds.xml", "config/smr_gpu.yaml"]),
    ],
    entry_points={
        "console_scripts": [
            f"smr_gpu_node = {NAME}.node:main",
            f"publish_pictures = {NAME}.publish_pictures:main",
            f"print_detections = {NAME}.print_detections:main",
        ]
    },
)
