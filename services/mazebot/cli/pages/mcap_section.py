"""The part of docs/recordings.md about `run.mcap`."""

from __future__ import annotations

from mazebot.common.recordings.mcap.mcap_messages import MADE_FROM, REPEATED, SOURCE, WORLD_HASH
from mazebot.common.recordings.run_folder import CONFIG, MESSAGES, SUMMARY

MCAP_ROW = (
    MESSAGES,
    "all messages, as they were on the wire: a ROS 2 bag ([MCAP](https://mcap.dev)), "
    "[described below](#runmcap)",
)
MCAP_SECTION = f"""
## {MESSAGES}

Every message that the recorder received, in the order in which they were sent; `recorded` in
`{SUMMARY}` counts them by topic. What the recorder itself publishes on `/evaluation` is in
`{SUMMARY}`.

| part | what |
| --- | --- |
| profile | `ros2`: schemas `ros2msg` with all definitions that a type needs, messages as CDR |
| log time | simulation time of sending, in ns; of receiving if the sender does not provide it |
| publish time | simulation time of sending, in ns |
| sequence | number of the message at its source, on its topic |
| channel | one for each topic, publisher and world. Metadata: `{SOURCE}` (the publisher), \
`{WORLD_HASH}` (the world for which the message is), `offered_qos_profiles` (`transient_local` for \
latched topics), `topic_type_hash` |
| attachments | `{CONFIG}` and `{SUMMARY}`, when the file is ended |
| metadata `mazebot` | run, world, its hash, seed, versions |
| metadata `foxglove` | `deviceName` (`mazebot-<world>`) and `sessionKey` (the run), by which \
Foxglove files a recording |

At the head stand the latched messages that are valid when the run begins: world, map, fixed frames,
textures, settings. A file larger than `segment_mib` ([parameters](parameters.md)) is ended, and
`run_2.mcap` follows. It begins with the latched messages of that moment, so that each file can be
used by itself; the metadata record `{REPEATED}` counts them by topic.

Camera images are recorded as JPEG, on `/camera/color/image_raw/compressed` with `{MADE_FROM}` in
the channel's metadata, and with `pictures: raw` as they were. Only then a replay of perception is
the same to the last bit. Depth images are always as they were.

What is written can be read at any time. A chunk is written every 0.4 s, so a killed recorder loses
at most 0.5 s; its successor continues the same file, or completes it. A full disk is reported in
`/diagnostics` within 1 s, and the recording continues when there is space.

### Open it

| with | how |
| --- | --- |
| [Foxglove](https://foxglove.dev) | *Open local file*; the world's scene is in Rerun's recording, \
Foxglove draws map, scan, path, transforms, camera and plots |
| ROS 2 | `ros2 bag info -s mcap {MESSAGES}`, `ros2 bag play -s mcap {MESSAGES}`; it holds \
`/clock`, so start your nodes with `use_sim_time`. The types of \
`/world` and other topics of Mazebot's own are in the package `mazebot_msgs` ([ros2.md](ros2.md)) |
| [rosbags](https://ternaris.gitlab.io/rosbags/) | without ROS, in Python: `AnyReader([path])` |
| [mcap](https://mcap.dev/docs/python/) | `make_reader(file, \
decoder_factories=[DecoderFactory()])`, the decoder from `mcap-ros2-support` |

```python
from pathlib import Path

from rosbags.highlevel import AnyReader

for path in Path("recordings").glob("*/{MESSAGES}"):
    with AnyReader([path]) as reader:
        scans = [one for one in reader.connections if one.topic == "/scan"]
        for connection, time_ns, data in reader.messages(scans):
            scan = reader.deserialize(data, connection.msgtype)
            print(path.parent.name, time_ns * 1e-9, min(scan.ranges))
```
"""
