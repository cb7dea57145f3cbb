"""`mavkf schema`."""

import json

from mavkf.publish.records import schema as record_schema


def schema() -> None:
    """Print the JSON schema of the records: Pose, SmoothedPose, Status, Innovation, Event."""
    print(json.dumps(record_schema(), indent=2))
