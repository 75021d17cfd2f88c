"""Write a rosbag2: a folder with one MCAP file and its `metadata.yaml`, version 9 (Jazzy).

Source: github.com/ros2/rosbag2, `rosbag2_storage/metadata_io` and `rosbag2_storage_mcap`.
"""

from pathlib import Path
from typing import Any, Self

import yaml
from mcap.well_known import MessageEncoding, Profile, SchemaEncoding
from mcap.writer import Writer

from teleop.errors import UsageError
from teleop.ros.graph import RELIABLE, Qos
from teleop.ros.message_types import compute_type_hash, encode, format_definition

VERSION = 9  # of metadata.yaml
_INFINITE_DURATION = {"sec": 9223372036, "nsec": 854775807}


class BagWriter:
    """A bag being written, as a context manager.

    Raises `UsageError` if the folder exists already or cannot be made.
    """

    def __init__(self, folder: Path) -> None:
        self.counts: dict[str, int] = {}  # messages by topic
        self._topics: dict[str, dict[str, Any]] = {}
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._first_ns = self._last_ns = 0
        self._folder, self._name = folder, f"{folder.name}_0.mcap"
        try:
            folder.mkdir(parents=True)
            self._file = (folder / self._name).open("xb")
        except FileExistsError as error:
            raise UsageError(f"{folder}: exists already; name a new folder for the bag") from error
        except OSError as error:
            raise UsageError(f"{folder}: cannot be made: {error.strerror}") from error
        self._mcap = Writer(self._file)
        self._mcap.start(profile=Profile.ROS2, library="tendon-teleop")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def write(self, topic: str, message: Any, qos: Qos, log_ns: int, publish_ns: int) -> None:
        """Add a message."""
        data = encode(message)
        self.write_bytes(topic, message.__msgtype__, data, qos, log_ns, publish_ns)

    def write_bytes(
        self, topic: str, type_name: str, data: bytes, qos: Qos, log_ns: int, publish_ns: int
    ) -> None:
        """Add the bytes of a message; times in ns since the Unix epoch."""
        channel = self._channels.get(topic)
        if channel is None:
            channel = self._register(topic, type_name, qos)
        self.counts[topic] += 1
        self._mcap.add_message(channel, log_ns, data, publish_ns, self.counts[topic])
        self._first_ns = min(self._first_ns or log_ns, log_ns)
        self._last_ns = max(self._last_ns, log_ns)

    def close(self) -> None:
        """Write index and metadata, and close the file."""
        if self._file.closed:
            return
        information = self._build_information()
        with self._file:
            text = yaml.safe_dump(information, sort_keys=False)
            self._mcap.add_metadata("rosbag2", {"serialized_metadata": text})
            self._mcap.finish()
        document = {"rosbag2_bagfile_information": information}
        (self._folder / "metadata.yaml").write_text(yaml.safe_dump(document, sort_keys=False))

    def _register(self, topic: str, type_name: str, qos: Qos) -> int:
        profiles = [_build_qos_profile(qos)]
        if type_name not in self._schemas:
            self._schemas[type_name] = self._mcap.register_schema(
                type_name, SchemaEncoding.ROS2, format_definition(type_name).encode()
            )
        schema = self._schemas[type_name]
        metadata = {
            "offered_qos_profiles": yaml.safe_dump(profiles, sort_keys=False),
            "topic_type_hash": compute_type_hash(type_name),
        }
        channel = self._mcap.register_channel(topic, MessageEncoding.CDR, schema, metadata)
        self._channels[topic], self.counts[topic] = channel, 0
        self._topics[topic] = {
            "name": topic,
            "type": type_name,
            "serialization_format": "cdr",
            "offered_qos_profiles": profiles,
            "type_description_hash": compute_type_hash(type_name),
        }
        return channel

    def _build_information(self) -> dict[str, Any]:
        span = {
            "duration": {"nanoseconds": self._last_ns - self._first_ns},
            "starting_time": {"nanoseconds_since_epoch": self._first_ns},
            "message_count": sum(self.counts.values()),
        }
        return {
            "version": VERSION,
            "storage_identifier": "mcap",
            **span,
            "topics_with_message_count": [
                {"topic_metadata": metadata, "message_count": self.counts[topic]}
                for topic, metadata in self._topics.items()
            ],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [self._name],
            "files": [{"path": self._name, **span}],
            "custom_data": None,
            "ros_distro": "jazzy",
        }


def _build_qos_profile(qos: Qos) -> dict[str, Any]:
    return {
        "history": "keep_last",
        "depth": qos.depth,
        "reliability": "reliable" if qos.reliability == RELIABLE else "best_effort",
        "durability": "volatile",
        "deadline": dict(_INFINITE_DURATION),
        "lifespan": dict(_INFINITE_DURATION),
        "liveliness": "automatic",
        "liveliness_lease_duration": dict(_INFINITE_DURATION),
        "avoid_ros_namespace_conventions": False,
    }
