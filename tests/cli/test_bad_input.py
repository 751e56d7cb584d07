"""Two hundred and more things that a person may get wrong: each is one line on standard error with
the flag or field and the value, and not exit code 0.
"""

from __future__ import annotations

import functools
import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
import yaml

from mazebot.cli.app import app
from mazebot.cli.parsing.known import fields_of_all, model_of
from mazebot.common.bus.session import open_session
from mazebot.common.config import ConfigError
from mazebot.common.files.root import ROOT
from mazebot.common.settings.known_settings import unknown_variable
from mazebot.common.settings.load import load
from tests.cli.test_app import mazebot
from tests.worldgen import folder

LONG = "x" * 5000

# A command, and what its line must hold: words with | between.
COMMANDS = """
nope : nope|must be one of demo
demoo : demoo|demo
worl list : worl|world
-5 : -5
--verison : --verison|--version
sim stpe : stpe|step
sim nope : nope|pause
keys mak : mak|make
keys make --keys file.txt : file.txt|must be a folder
keys list --keys '' : --keys|empty
keys list --keys file.txt : file.txt|must be a folder
keys add : NAME
keys add Anna : Anna|lower-case
keys add ../anna : ../anna|lower-case
keys add anna --role king : king|operator
keys add physics : physics|service
keys revoke bob : bob|has no key
keys rotate bob : bob|has no key
security matrix extra : extra
security explain bob /cmd_vel : bob|operator
security explain viewer /cmd_vl : /cmd_vl|must be a topic
security explain viewer a//b : a//b|key expression
security explain viewer /cmd_vel drive : drive|put, subscribe
up --keys file.txt : file.txt|must be a folder
topic ech : ech|echo
world chekc : chekc|check
recordings lst : lst|list
markers mak : mak|make
demo --nope : --nope|mazebot demo --help
demo --sed 3 : --sed|--seed
demo --worl maze : --worl|--world
demo extra : extra
demo --seed : --seed|a value
demo --seed -1 : --seed|-1|greater than or equal to 0
demo --seed=-1 : --seed|-1
demo --seed x : --seed|x|integer
demo --seed 1.5 : --seed|1.5|integer
demo --seed '' : --seed|empty
demo --world atlantis : atlantis|sim_house_enhanced
demo --world '' : --world|empty
demo --world= : --world|empty
demo --world --no-record : --no-record
demo --world_name ../x : ../x
demo --renderer vulkan : --renderer|vulkan|'auto'
demo --renderer GL : --renderer|GL
demo --camera=no : --camera
demo --console-port 8080 : --console-port|--console
demo --router-port 7447 : --router-port|--console
console --login maybe : login|maybe|'auto'
up --world orignal : --world|orignal|did you mean original?
up --only navigatin : --only|navigatin|did you mean navigation?
up --router-port 0 : --router-port|0
up --seed -1 : --seed|-1
up extra : extra
down --router-port x : --router-port|x|integer
down extra : extra
ps --jsno : --jsno|--json
ps --router-port 65536 : --router-port|65536
logs navigatoin : navigatoin|did you mean navigation?
logs --router-port : --router-port|a value
stop --jsno : --jsno|--json
stop smoke --clear : REASON|smoke|without --clear
demo --console --router-port 65536 : --router-port|65536
demo --no-tour : --no-tour|--console
demo --console --no-tour --goal 1 0 0 : --no-tour|--goal
demo --console --console-port 65536 : --console-port|65536
demo --console --config console.yaml : bind|1.2.3.4|of this machine
demo --use_aruco maybe : --use_aruco|maybe|True
demo --use_aruco 2 : --use_aruco|2
demo --texture_base nowhere --world enhanced : nowhere
demo --texture_base nowhere --world original : texture_base|nowhere|folder
demo --texture_base '' : --texture_base|empty
demo --worlds-dir nowhere : nowhere
demo --worlds-dir file.txt : file.txt
demo --worlds-dir '' : --worlds-dir|empty
demo --goal 0.5 -0.9 0 --goal 1 1 : --goal|1 1|must be given once
demo --world original --world=enhanced : --world|enhanced|must be given once
plan --map a.yaml --start 0,0 --goal 1,1 --map b.yaml : --map|b.yaml|must be given once
demo --goal 1 : --goal|1|Y|2 or 3 numbers
demo --goal 1 nan 0 : --goal|nan|finite
demo --goal inf 0 0 : --goal|inf|finite
demo --goal a 0 0 : --goal|a|number
demo --goal 1,2,3,4 : --goal|1,2,3,4|2 or 3 numbers
demo --goal 1,x : --goal|Y|x|number
demo --goal : --goal|a value
demo --slam --map map.yaml : --map|map.yaml|without --slam
demo --explore : --explore|--slam
demo --no-explore : --explore|--slam
demo --slam --no-explore : --no-explore|--goal
demo --slam --explore --goal 0 0 0 : --goal|--explore
demo --slam=yes : --slam
demo --map nowhere.yaml : nowhere.yaml
demo --map '' : --map|empty
demo --map file.txt : file.txt
demo --map broken.yaml : broken.yaml
map nope : nope|save
map save : NAME
map save a/-b : -b|letters
map save ../ä : ä|letters
map save '' : empty
demo --out '' : --out|empty
demo --out file.txt : --out|file.txt|folder
demo --out file.txt/run : --out|file.txt/run
demo --out run : --out|run|summary.json
demo --out /proc/nope : --out|/proc/nope
demo --out {long} : --out|xxxx|too long
demo --set nope=1 --world original : nope
demo --set wall_height_m --world original : wall_height_m
demo --set wall_height_m=-1 --world original : wall_height_m|-1
demo --set wall_height_m=nan --world original : wall_height_m|nan
demo --set wall_height_m=tall --world original : wall_height_m|tall
demo --set =3 --world original : =3
demo --set '' : --set|empty
demo --set walls[99].length_m=1 --world original : walls[99]
demo --set "walls=[" --world original : walls
demo --set maze.rows=0 --world maze : rows|0
demo --set maze.rows=1e9 --world maze : rows|e9
demo --set maze.seed=x --world maze : seed|x
demo --set maze.nope=1 --world maze : nope
demo --config : --config|a value
demo --config empty.yaml : empty.yaml|is empty|sections
demo --world ./empty.yaml : empty.yaml|is empty|mapping
demo --map empty.yaml --world original : empty.yaml|is empty|mapping
demo --config nested.yaml : nested.yaml|controler|did you mean controller_server.controller?
demo --config mppi.yaml : mppi.yaml|controller_server.mppi.max_sped|controller_server.mppi.vx_max
demo --config nowhere.yaml : nowhere.yaml|No such file
demo --config . : .|must be a file
demo --config '' : --config|empty
demo --config broken.yaml : broken.yaml:2|not YAML
demo --config tab.yaml : tab.yaml:2|a tab
demo --config binary.yaml : binary.yaml|UTF-8
demo --config control.yaml : control.yaml|control character
demo --config tag.yaml : tag.yaml:1|tag
demo --config list.yaml : list.yaml|1|mapping
demo --config text.yaml : text.yaml|hello|mapping
demo --config section.yaml : section.yaml|physcis|physics
demo --config field.yaml : field.yaml|physics.rendrer|cpu|renderer
demo --config other_field.yaml : other_field.yaml|router.lsiten|listen
demo --config value.yaml : value.yaml|renderer|vulkan
demo --config type.yaml : type.yaml|scan_rate_hz|fast
demo --config nan.yaml : nan.yaml|scan_noise_m|nan
plan --map nowhere.yaml --start 0,0 --goal 1,1 : nowhere.yaml|No such file
plan --map map.yaml --start 0,0 --goal 1,1 --keepout text.yaml : --keepout|text.yaml|hello
plan --map map.yaml --start 0,0 --goal 1,1 --speed broken.yaml : --speed|broken.yaml:2|not YAML
localize : --map|--log|--global
localize --log log.csv : --map|--log
localize --map map.yaml : --log|--map
localize --global --start 0 0 0 : --start|--map
localize --global --range-max 3 : --range-max|--map and --log
localize --global --timeout 0 : --timeout|0
localize --map map.yaml --log log.csv --timeout 3 : --timeout|--map
localize --map map.yaml --log log.csv --range-max 0 : --range-max|0
map bild : bild|build
map build : --log
map build --log file.txt : --out
map build --log nowhere.log --out new : nowhere.log|no such file
map build --log file.txt --out new : file.txt:1|time_s|FLASER
map build --log damaged.log --out new : damaged.log:2|num_readings|x
map build --log file.txt --out file.txt : --out|file.txt|folder
map build --log file.txt --out file.txt/new : --out|file.txt/new|folder
map build --log file.txt --out new --draw nowhere/a.png : --draw|nowhere
map build --log file.txt --out new --relations nowhere.txt : --relations|nowhere.txt|No such file
map build --log file.txt --out new --relations file.txt : --relations|file.txt:1|8 numbers
map build --log file.txt --out new --params nowhere.yaml : nowhere.yaml|No such file
map build --log file.txt --out new --params list.yaml : list.yaml|mapping
map build --log file.txt --out new --params section.yaml : section.yaml:1|physcis|no such parameter
map build --log file.txt --out new --range-min -1 : --range-min|-1
map build --log file.txt --out new --range-max 0.1 --range-min 3 : --range-max|0.1|--range-min
map build --log file.txt --out new --angle-min nan : --angle-min|nan
map build --log file.txt --out new --angle-increment 0 : --angle-increment|0
map build --log file.txt --out new --odom-scale 0 : --odom-scale|0
map build --log file.txt --out new --lidar 0 0 inf : --lidar|inf|finite
map build --log file.txt --out new --lidar 0 : --lidar|0|Y|2 or 3 numbers
waypoints : FILE|NAME
waypoints 1,2 3,4,5,6 : 3,4,5,6|2 or 3 numbers
waypoints nowhere.yaml : nowhere.yaml|No such file
waypoints broken.yaml : broken.yaml:2|not YAML
waypoints text.yaml : text.yaml|hello|mapping
waypoints section.yaml : section.yaml|physcis|waypoints
waypoints hall section.yaml : section.yaml|only argument
waypoints '' : empty
waypoints hall --loops -1 : --loops|-1
waypoints hall --photos file.txt : --photos|file.txt|folder
waypoints hall --timeout x : --timeout|x
dock --timeout 0 : --timeout|0
dock a b : b
undock now : now
spin nan : ANGLE|nan|finite
spin left : ANGLE|left
spin 1 --time-allowance -1 : --time-allowance|-1
backup 0 : DISTANCE|0
backup -0.1 : DISTANCE|-0.1
backup inf : DISTANCE|inf
backup 0.1 --speed nan : --speed|nan
teleop : standard input|terminal
teleop --speed 3 : --speed|3|0.46
teleop --turn 0 : --turn|0
localize --map nowhere.yaml --log log.csv : nowhere.yaml|No such file
demo --params nowhere.yaml : nowhere.yaml|No such file
demo --params nav2.yaml : nav2.yaml:1|amcl.sigma_hit|0.0|greater than 0
params : FILE
params nowhere.yaml : nowhere.yaml|No such file
params . : must be a file
params tag.yaml : tag.yaml:1|physics|ros__parameters
params list.yaml : list.yaml:1|mapping
params nav2.yaml : nav2.yaml:1|amcl.sigma_hit|0.0|greater than 0
params nav2.yaml --jsn : --jsn|--json
demo --config rate.yaml : rate.yaml|scan_rate_hz|7
demo --config seed.yaml : seed.yaml|seed|-3
demo --config scalar.yaml : scalar.yaml|physics|5|mapping
demo --config goal.yaml : goal.yaml|goal|[1.0, 2.0]
demo --config run_field.yaml : run_field.yaml|navigation.tolrance|1|tolerance
demo --config run_top.yaml : run_top.yaml|sed|seed
demo --config led.yaml : led.yaml|only_ask|Session
demo --config hash.yaml : hash.yaml|world_hash|0123456789abcdef
demo --config out_dir.yaml : out_dir|file.txt
replay : RUN
replay '' : empty
replay nowhere : nowhere|rosbag2
replay nowhere --dir gone : nowhere|gone
replay file.txt : file.txt|MCAP
replay . : .|run.mcap|rosbag2
replay run --service navigation : run|run.mcap
replay run --service nope : --service|nope|navigation
replay run --service recorder : recorder|evaluation
replay run --service '' : --service|empty
replay run --speed -1 : --speed|-1
replay run --speed x : --speed|x
replay run --speed nan : --speed|nan
replay run --speed 2 --service navigation : --speed|--service
replay run --loop --service navigation : --loop|--service
replay run --only /nope : /nope
replay run --only /scna : /scna|/scan
replay run --without nope : --without|nope|navigation
replay run --without physics : --without|physics|clock
replay run --set a=1 : --set|--service
replay run --config nowhere.yaml : --config|--service
replay run --start -1 : --start|-1
replay run --start nan : --start|nan
replay run --duration 0 : --duration|0
replay run --json : --json|--compare
replay run --compare : --compare|--without
replay run --lockstep : --lockstep|--without
replay run --spede 2 : --spede|--speed
diff : RUN
diff run : RUN
diff run nowhere : nowhere
diff nowhere run : nowhere
diff run run : run|digests.bin
diff '' run : ''|empty
diff run run --dri x : --dri|--dir
diff broken_run run : broken_run|digests.bin
goal : X
goal 1 : Y
goal 1 2 3 4 : 4
goal a 0 0 : X|a|number
goal 0 b 0 : Y|b|number
goal 0 0 c : YAW|c|number
goal nan 0 0 : X|nan|finite
goal 0 -inf 0 : Y|-inf|finite
goal 0 0 inf : YAW|inf|finite
goal 1 -0.5 0 --timeout 0 : --timeout|0|0.1
goal 1 -0.5 0 --timeout -5 : --timeout|-5
goal 1 -0.5 0 --timeout x : --timeout|x
goal 1 -0.5 0 --tiemout 5 : --tiemout|--timeout
goal 1 -0.5 0 --connect '' : --connect|empty
goal 1 -0.5 0 --connect tcp/127.0.0.1:1 : tcp/127.0.0.1:1|router
goal 1 -0.5 0 --connect rubbish : rubbish
cancel 3 : 3
cancel --connect tcp/127.0.0.1:1 : tcp/127.0.0.1:1
sim pause 3 : 3
sim pause --connect tcp/127.0.0.1:1 : tcp/127.0.0.1:1
sim step -5 : step|-5
sim step 0 : step|0
sim step x : N|x|integer
sim step 1.5 : N|1.5|integer
sim step 99999999999 : step|99999999999
sim load-world : WORLD
sim load-world maze --connect tcp/127.0.0.1:1 : tcp/127.0.0.1:1
sim run-until : T
sim run-until -1 : run_until_s|-1
sim run-until nan : run_until_s|nan
sim run-until soon : T|soon
sim run-until 1e300 : run_until_s|e+300
sim speed : X
sim speed -1 : speed|-1
sim speed nan : speed|nan
sim speed 0.001 : speed|0.001
sim speed fest : speed|fest
sim speed 1e9 : speed|1e9
sim reset --seed -3 : seed|-3
sim reset --seed x : --seed|x
sim reset --sed 3 : --sed|--seed
sim reset --scope half : --scope|half|fresh
sim reset --time-only --scope all : --scope|all|time
sim stats 3 : 3
topic list 3 : 3
topic list --connect tcp/127.0.0.1:1 : tcp/127.0.0.1:1
topic info : TOPIC
topic info /scna : /scna|/scan
doctor : --ros|must be given
doctor --rso : --rso|--ros
doctor --ros extra : extra
topic hz /nope : /nope|/scan
topic hz '' : empty
topic hz /scan --window 0 : --window|0|0.5
topic hz /scan --window -3 : --window|-3
topic hz /scan --window nan : --window|nan
topic hz /scan --window x : --window|x
topic echo /nope : /nope
topic echo scam : scam|/scan
topic echo /scan --timeout 0 : --timeout|0
topic echo /scan --timeout nan : --timeout|nan
topic echo /scan --onec : --onec|--once
topic pub : TOPIC
topic pub /nope {{}} : /nope
topic pub /scan {{}} : /scan|physics|/cmd_vel
topic pub /explore/resume "{{data: 3}}" : /explore/resume|data|3
topic pub /explore/resume "{{stop: true}}" : /explore/resume|stop
topic pub /cmd_vel 5 : /cmd_vel|5|fields
topic pub /cmd_vel [] : /cmd_vel|[]|fields
topic pub /cmd_vel "{{twist: {{linear: {{x: 1" : /cmd_vel|twist|not closed
topic pub /cmd_vel "{{twst: 1}}" : twst|1|twist
topic pub /cmd_vel "{{twist: 1}}" : twist|1|fields
topic pub /cmd_vel "{{twist: {{linear: {{x: fast}}}}}}" : twist.linear.x|fast|number
topic pub /cmd_vel "{{twist: {{linear: {{x: true}}}}}}" : twist.linear.x|True|number
topic pub /cmd_vel "{{twist: {{linear: {{x: null}}}}}}" : twist.linear.x|None|number
topic pub /cmd_vel "{{twist: {{linear: {{x: , y: 0.5}}}}}}" : twist.linear.x|None|number
topic pub /cmd_vel "{{twist: {{linear: null}}}}" : twist.linear|None|fields
topic pub /cmd_vel "{{header: {{frame_id: null}}}}" : header.frame_id|None|string
topic pub /cmd_vel "{{header: {{stamp: {{sec: null}}}}}}" : stamp.sec|None|integer
topic pub /explore/resume "{{data: null}}" : /explore/resume|data|None|true or false
topic pub /initialpose "{{pose: {{covariance: null}}}}" : pose.covariance|None|list
topic pub /cmd_vel "{{twist: {{linear: {{x: .nan}}}}}}" : nan|not finite
topic pub /cmd_vel "{{twist: {{linear: {{x: .inf}}}}}}" : inf|not finite
topic pub /cmd_vel "{{header: {{frame_id: 3}}}}" : header.frame_id|3|string
topic pub /cmd_vel "{{header: {{stamp: {{nanosec: -1}}}}}}" : stamp.nanosec|-1|integer
topic pub /cmd_vel "{{header: {{stamp: {{sec: 1.5}}}}}}" : stamp.sec|1.5|integer
topic pub /initialpose "{{pose: {{covariance: [1]}}}}" : pose.covariance|[1]|36
topic pub /initialpose "{{pose: {{covariance: 3}}}}" : pose.covariance|3|list
topic pub /goal_pose "{{pose: {{orientation: {{z: 5}}}}}}" : z|5|normalized
topic pub /cmd_vel {{}} --rate 0 : --rate|0
topic pub /cmd_vel {{}} --rate -1 : --rate|-1
topic pub /cmd_vel {{}} --rate x : --rate|x
topic pub /cmd_vel {{}} --times 0 : --times|0
topic pub /cmd_vel {{}} --connect tcp/127.0.0.1:1 : tcp/127.0.0.1:1
spawn : name
spawn a : a
spawn a --at 1 2 : --box
spawn a --box 1 1 1 : --at
spawn a --box 1 1 --at 0 0 : --box|1 1|3 numbers
spawn a --box 1 -1 1 --at 0 0 : --box|-1
spawn a --box 1 x 1 --at 0 0 : x
spawn a --box 1 1 1 --at 0 : --at|0|2 or 3
spawn a --box 1 1 1 --at 0 nan : --at|nan|finite
spawn a --cylinder 0 1 --at 0 0 : --cylinder|0
spawn a --sphere -1 --at 0 0 : --sphere|-1
spawn a --sphere inf --at 0 0 : --sphere|inf
spawn a --mesh nowhere.obj --at 0 0 : nowhere.obj
spawn a --mesh file.txt --at 0 0 : file.txt
spawn a --model nowhere --at 0 0 : nowhere
spawn a --model nowhere --models gone --at 0 0 : --models|gone
spawn a --marker -1 --at 0 0 0 --yaw 0 : --marker|-1
spawn a --marker 5000 --at 0 0 0 --yaw 0 : 5000
spawn a --marker 5 --dictionary NOPE --at 0 0 1 --yaw 0 : NOPE
spawn a --marker 5 --size -1 --wall Wall_1 : -1
spawn a --marker 5 --side up --wall Wall_1 : side|up
spawn a --box 1 1 1 --at 0 0 --mass -1 : mass|-1
spawn a --box 1 1 1 --at 0 0 --mass x : --mass|x
spawn a --box 1 1 1 --at 0 0 --colour 2 0 0 : --colour|2 0 0|0 to 1
spawn a --box 1 1 1 --at 0 0 --colour 1 0 : --colour|1 0
spawn a --box 1 1 1 --at 0 0 --texture nowhere.png : nowhere.png
spawn a --box 1 1 1 --at 0 0 --path 1 : --path|1
spawn a --box 1 1 1 --at 0 0 --path 1 1 --speed 0 : --path|speed|0
spawn a --box 1 1 1 --at 0 0 --yaw nan : --yaw|nan
spawn a --box 1 1 1 --at 0 0 --yaw 1 --rpy 0 0 0 : --yaw|--rpy
spawn a --box 1 1 1 --at 0 0 --timeout 0 : --timeout|0
move : name
move a : --at
move a --at x y : x
move a --at 1 : --at|1
move a --yaw x : --yaw|x
remove : --all
remove a --all : --all
entities 3 : 3
entities --timeout nan : --timeout|nan
recordings list --dir nowhere : --dir|nowhere
recordings list --dir file.txt : --dir|file.txt
recordings list --dir '' : --dir|empty
recordings list --since yesterday : --since|yesterday|7d
recordings list --since '' : --since|empty
recordings list --since 1e99d : --since|1e99d
recordings list --since 99999999999w : --since|99999999999w
recordings list --sort colour : --sort|colour|'started'
recordings list --tag : --tag|a value
recordings list extra : extra
recordings info : RUN
recordings info nope : nope|no such run
recordings info ../run : ../run
recordings info '' : ''|empty
recordings info run --dir file.txt : --dir|file.txt
recordings report : RUN
recordings report nope : nope|no such run
recordings report run nope : nope|no such run
recordings compare : RUN
recordings compare run : run|two runs
recordings compare run nope : nope|no such run
recordings compare run broken_run --dir nowhere : --dir|nowhere
recordings export : --out
recordings export --out runs.xlsx : --out|runs.xlsx|.parquet
recordings export --out nowhere/runs.csv : --out|nowhere/runs.csv
recordings export --out runs.csv --since soon : --since|soon
recordings prune : --keep-days|--keep-gb|--keep-last
recordings prune --keep-days -1 : --keep-days|-1
recordings prune --keep-days soon : --keep-days|soon
recordings prune --keep-gb nan : --keep-gb|nan
recordings prune --keep-gb x : --keep-gb|x
recordings prune --keep-last 1.5 : --keep-last|1.5
recordings prune --keep-last 0 --dir nowhere : --dir|nowhere
recordings repair nope : nope|no such run
recordings repair run : run|complete
recordings repair --dir nowhere : --dir|nowhere
recordings tag : RUN
recordings tag nope a : nope|no such run
recordings tag run 'a b' : 'a b'|letters
recordings tag run ../x : '../x'|letters
recordings tag run --note : --note|a value
console --dir nowhere : --dir|nowhere
console --port 70000 : --port|70000
console --bind 1.2.3.4 --port 0 --no-live : bind|1.2.3.4|of this machine
recordings view nope : nope
recordings view --dir nowhere : nowhere
recordings view nope --port 0 : --port|0
recordings view nope --port 70000 : --port|70000
recordings view nope --port x : --port|x
recordings view nope --layout x : --layout|x
recordings compress nope : nope
recordings compress --dir nowhere : --dir|nowhere
world show nope : nope
world show nowhere.yaml : nowhere.yaml
world show nowhere.sdf : nowhere.sdf
world show file.sdf : file.sdf
world show maze --frames : --frames|maze
world show maze --arg a:=1 : --arg|a:=1
world show maze --path nowhere : --path|nowhere
world show maze --set maze.rows=-2 : rows|-2
world list --worlds-dir nowhere : nowhere
world list --worlds-dir empty : --worlds-dir|empty
world build maze : --out
world build maze --out file.txt : --out|file.txt
world build maze --out new --count 0 : --count|0
world build original --out new --count 3 : --count|3|maze
world build nope --out new : nope
world export nope --out new : nope
world export original --out file.txt : file.txt
world preview nope : nope
world preview original --out nowhere/a.png : --out|nowhere/a.png
world preview original --out a.png --glb a.png : --glb|a.png
world import broken.sdf --arg x : --arg|x
markers make : ID
markers make -5 : ID|-5
markers make x : ID|x
markers make 5 --size 0 : 0
markers make 5 --size nan : nan
markers make 5 --kind ball : --kind|ball|panel
markers make 5 --dictionary NOPE : NOPE
markers make 5 --dictionary nowhere.yml : nowhere.yml
markers make 5 --quiet-zone 0 : --quiet-zone|0
markers make 5000 : 5000
markers make 5 --out file.txt : file.txt
markers detect : IMAGE
markers detect nowhere.png : nowhere.png
markers detect file.txt : file.txt|image
markers detect file.txt --size x : --size|x
markers detect file.txt --dictionary NOPE : --dictionary|NOPE
"""

# An environment, and what its line must hold, of `mazebot world list`.
VARIABLES = """
MAZEBOT_SEEED=3 : MAZEBOT_SEEED|MAZEBOT_SEED
MAZEBOT_PHYSICS_RENDRER=cpu : MAZEBOT_PHYSICS_RENDRER|MAZEBOT_PHYSICS_RENDERER
MAZEBOT_PHYSCIS_RENDERER=cpu : MAZEBOT_PHYSCIS_RENDERER|MAZEBOT_PHYSICS_RENDERER
MAZEBOT_RENDERER=cpu : MAZEBOT_RENDERER|MAZEBOT_PHYSICS_RENDERER
MAZEBOT_NAVIGATION_INFLATION_RADUIS=1 : INFLATION_RADUIS|INFLATION_LAYER__INFLATION_RADIUS
MAZEBOT_NAVIGATION_INFLATION_RADIUS=1 : ambiguous|LOCAL_COSTMAP__INFLATION_LAYER__INFLATION_RADIUS
MAZEBOT_NAVIGATION_DESIRED_LINEAR_VEL=1 : MAZEBOT_NAVIGATION_CONTROLLER_SERVER__MAX_LINEAR_VEL
MAZEBOT_ROUTER_PROT=1 : MAZEBOT_ROUTER_PROT|MAZEBOT_ROUTER_PORT
MAZEBOT_ROUTER_LSITEN=1 : MAZEBOT_ROUTER_LSITEN|MAZEBOT_ROUTER_LISTEN
MAZEBOT_BUS_CONECT=x : MAZEBOT_BUS_CONECT|MAZEBOT_BUS_CONNECT
MAZEBOT_XYZ=1 : MAZEBOT_XYZ
MAZEBOT_CONFIG=nowhere.yaml : nowhere.yaml
MAZEBOT_CONFIG=section.yaml : section.yaml|physcis
MAZEBOT_PARAMS=nav2.yaml : nav2.yaml|amcl.sigma_hit
MAZEBOT_WORLDGEN_WORLDS_DIR=nowhere : nowhere
"""

# The same of `mazebot demo --world original --no-record`.
DEMO_VARIABLES = """
SEED=8 : SEED|8|--seed 8
WORLD=maze : WORLD|maze|--world maze
SET=maze.rows=3 : SET|maze.rows=3|--set
WORLD_SET=maze.rows=3 : WORLD_SET|maze.rows=3|--set
WORLDS_DIR=/worlds : WORLDS_DIR|/worlds|--worlds-dir
PACE=0.5 : PACE|0.5|lockstep
USE_ARUCO=maybe : --use_aruco|maybe
MAZEBOT_SEED=-1 : seed|-1|MAZEBOT_SEED
MAZEBOT_SEED=x : seed|x|MAZEBOT_SEED
MAZEBOT_PHYSICS_SCAN_RATE_HZ=7 : scan_rate_hz|7|MAZEBOT_PHYSICS_SCAN_RATE_HZ
MAZEBOT_PHYSICS_RENDERER=vulkan : renderer|vulkan|MAZEBOT_PHYSICS_RENDERER
MAZEBOT_PHYSICS_ROBOT_MODEL=nope : robot_model|nope
MAZEBOT_NAVIGATION_LOCAL_COSTMAP__INFLATION_LAYER__INFLATION_RADIUS=-1 : inflation_radius|-1
MAZEBOT_NAVIGATION_MAX_LINEAR_VEL=-1 : controller_server.max_linear_vel|-1|MAX_LINEAR_VEL
MAZEBOT_BRINGUP_TOUR=here : MAZEBOT_BRINGUP_TOUR|here
MAZEBOT_BRINGUP_TOUR=["here"] : here|location1
MAZEBOT_BRINGUP_GOAL=[1,2] : goal|[1, 2]
MAZEBOT_BRINGUP_WORLD_OVERRIDES=[1 : world_overrides|[1
MAZEBOT_PERCEPTION_THRESHOLD_WINDOW_PX=4 : threshold_window_px|4|odd
MAZEBOT_RECORDER_WEB_PORT=0 : web_port|0
MAZEBOT_RECORDER_RECORDINGS_DIR=file.txt : file.txt
"""

# A recipe laid over a sound one, and what the line must hold, beside the file.
RECIPES = """
nope: 1 : nope|1
name: 3 : name|3
walls: 3 : walls|3
walls: [] : walls
walls: [{name: a}] : walls[0]
walls: [{name: a, length_m: -1, x_m: 0, y_m: 0, yaw_rad: 0}] : walls[0].length_m|-1
walls: [{name: a, length_m: .nan, x_m: 0, y_m: 0, yaw_rad: 0}] : walls[0].length_m|nan
walls: [{name: a, length_m: 1, x_m: 1e9, y_m: 0, yaw_rad: 0}] : walls[0].x_m|000000
wall_height_m: 0 : wall_height_m|0
wall_height_m: tall : wall_height_m|tall
wall_thickness_m: -1 : wall_thickness_m|-1
map_resolution_m: 0 : map_resolution_m|0
map_resolution_m: 1e-9 : map_resolution_m|e-09
start: {x_m: 0} : start
start: {x_m: nan, y_m: 0} : start.x_m|nan
start: {x_m: 99, y_m: 0} : start|99
locations: {a: {x_m: 0}} : locations.a
locations: [1] : locations|1
wall_materials: [gold] : wall_materials[0]|gold
floor_material: gold : floor_material|gold
materials: {brick: {texture: nowhere.png}, plain: {}} : nowhere.png
materials: {a: {diffuse: [2, 0, 0, 1]}} : diffuse|2
rooms: {a: {polygon_m: [[0, 0]]}} : polygon_m
markers: [{id: 5, wall: nope, side: left, height_m: 0.3}] : markers[0].wall|nope
markers: [{id: -5, wall: north, side: left, height_m: 0.3}] : markers[0].id|-5
light: {direction: [0, 0, 0]} : light.direction
extends: nowhere.yaml : nowhere.yaml
maze: {rows: 0} : maze.rows|0
"""

FILES = {
    "console.yaml": "console:\n  bind: 1.2.3.4\n  port: 0\n",
    "file.txt": "text",
    "damaged.log": "# CARMEN Logfile\nFLASER x 1 2\nSYNC end\n",
    "file.sdf": "not xml",
    "broken.sdf": "<sdf><world>",
    "broken.yaml": "physics: {\n",
    "tab.yaml": "physics:\n\trenderer: cpu\n",
    "control.yaml": "physics: {renderer: \x01}\n",
    "tag.yaml": "physics: !!python/object:os.system x\n",
    "list.yaml": "[1, 2]\n",
    "text.yaml": "hello\n",
    "nav2.yaml": "amcl: {ros__parameters: {sigma_hit: 0.0}}\n",
    "section.yaml": "physcis: {renderer: cpu}\n",
    "field.yaml": "physics: {rendrer: cpu}\n",
    "other_field.yaml": "router: {lsiten: x}\n",
    "value.yaml": "physics: {renderer: vulkan}\n",
    "type.yaml": "physics: {scan_rate_hz: fast}\n",
    "nan.yaml": "physics: {scan_noise_m: .nan}\n",
    "rate.yaml": "physics: {scan_rate_hz: 7}\n",
    "seed.yaml": "seed: -3\n",
    "scalar.yaml": "physics: 5\n",
    "goal.yaml": "bringup: {goal: [1.0, 2.0]}\n",
    "run_field.yaml": "services: {navigation: {tolrance: 1}}\nseed: 7\n",
    "run_top.yaml": "services: {}\nsed: 7\n",
    "led.yaml": "services: {bringup: {only_ask: true}}\n",
    "hash.yaml": "services: {bringup: {world_name: original}}\nworld_hash: 0123456789abcdef\n",
    "out_dir.yaml": "recorder: {out_dir: file.txt/run}\nbringup: {world_name: original}\n",
    "run/summary.json": "{}",
    "run/config.yaml": "{}",
    "broken_run/summary.json": "{}",
    "broken_run/digests.bin": "rubbish",
    "empty/readme.txt": "",
    "empty.yaml": "# nothing yet\n",
    "nested.yaml": "navigation: {controller_server: {controler: mppi}}\n",
    "mppi.yaml": "navigation: {controller_server: {mppi: {max_sped: 1}}}\n",
}


def rows(table: str) -> list[tuple[str, list[str]]]:
    """Each line of a table, with the words behind its last " : "."""
    parts = [line.rpartition(" : ") for line in table.strip().splitlines()]
    return [(given, words.split("|")) for given, _, words in parts]


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A working folder with the files above."""
    with pytest.MonkeyPatch.context() as patch:
        path = tmp_path_factory.mktemp("bad")
        for name, text in FILES.items():
            (path / name).parent.mkdir(exist_ok=True)
            (path / name).write_text(text)
        (path / "binary.yaml").write_bytes(b"a: \xff\n")
        # Nobody is ever there.
        soon = functools.partial(open_session, timeout_s=0.05)
        patch.setattr("mazebot.common.bus.session.open_session", soon)
        patch.chdir(path)
        yield path


def refused(*arguments: str, **environment: str) -> str:
    """The one line that a command ends with."""
    done = mazebot(*arguments, **environment)
    said = done.stdout + done.stderr
    assert done.returncode not in (0, None), said
    assert "Traceback" not in said
    lines = [line for line in done.stderr.splitlines() if line.strip()]
    assert len(lines) == 1, said
    assert lines[0].startswith("error: "), said
    return lines[0]


def assert_told(line: str, words: list[str]) -> None:
    for word in words:
        assert word in line, line


@pytest.mark.parametrize(("command", "words"), rows(COMMANDS))
def test_a_bad_command_is_one_line(here: Path, command: str, words: list[str]) -> None:
    before = sorted(here.rglob("*"))
    assert_told(refused(*shlex.split(command.format(long=LONG))), words)
    assert sorted(here.rglob("*")) == before


@pytest.mark.parametrize(("setting", "words"), rows(VARIABLES))
def test_a_bad_variable_is_one_line(here: Path, setting: str, words: list[str]) -> None:
    name, _, value = setting.partition("=")
    assert_told(refused("world", "list", **{name: value}), words)


@pytest.mark.parametrize(("setting", "words"), rows(DEMO_VARIABLES))
def test_a_bad_variable_of_a_run_is_one_line(here: Path, setting: str, words: list[str]) -> None:
    name, _, value = setting.partition("=")
    world = [] if name == "WORLD" else ["--world", "original"]
    line = refused("demo", *world, "--no-record", "--no-camera", **{name: value})
    assert_told(line, words)
    assert not (here / "recordings").exists()


@pytest.mark.parametrize(("change", "words"), rows(RECIPES))
def test_a_bad_recipe_is_one_line(tmp_path: Path, change: str, words: list[str]) -> None:
    recipe = {**folder.room(), **yaml.safe_load(change)}
    worlds_dir = folder.make(tmp_path / "worlds", recipe)
    line = refused("demo", "--world", "room", "--worlds-dir", str(worlds_dir), "--no-record")
    assert_told(line, ["room.yaml", *words])


# Flags of a service, and what its line must hold.
FLAGS = """
physics --rendrer cpu : --rendrer|cpu|--renderer
physics --scan-rate 3 : --scan-rate|3|--scan-rate-hz
physics --scan-rate=3 : --scan-rate|3|--scan-rate-hz
physics --renderer : --renderer|a value
physics --renderer vulkan : renderer|vulkan|'auto'
physics --camera-enabled maybe : camera_enabled|maybe|--camera-enabled
physics --camera-depth-max-m 0.1 : camera_depth_max_m|0.1
physics --scan-rate-hz '' : scan_rate_hz|''|--scan-rate-hz
physics extra : extra
physics --config nowhere.yaml : nowhere.yaml
physics --config field.yaml : physics.rendrer|cpu
bringup --tour '["a"' : tour|["a"|--tour
bringup --goal 1 : goal|1|--goal
bringup --goal '[1,nan,0]' : goal|nan
bringup --world-overrides '[1' : world_overrides|[1|JSON
localization --max-particles x : max_particles|x|--max-particles
localization --nope 3 : --nope|3
perception --threshold-window-px 4 : threshold_window_px|4|must be odd
perception --second-window-px 22 : second_window_px|22|must be odd
perception --min-clarity -1 : min_clarity|-1
recorder --grpc-port 99999 : grpc_port|99999
recorder --pictures png : pictures|png|'jpeg' or 'raw'
recorder --segment-mib 0 : segment_mib|0|--segment-mib
recorder --messages perhaps : messages|perhaps
spawner --module-px 1 : module_px|1
worldgen --worlds-dri x : --worlds-dri|x|--worlds-dir
router --listen x : listen|x|--listen
router --tls-hosts 'bad host,*' : tls_hosts|'bad host'|name or the IP address|--tls-hosts
router --tls-hosts 'localhost,*' : tls_hosts|'*'|--tls-hosts
router --tls-hosts 300.1.1.1 : tls_hosts|'300.1.1.1'|--tls-hosts
console --port 70000 : port|70000|--port
console --hosts http://lab : hosts|http://lab|without scheme
console --max-body-kib 0 : max_body_kib|0
bus --pace slow : pace|slow|real_time
"""


@pytest.mark.parametrize(("command", "words"), rows(FLAGS))
def test_a_bad_flag_of_a_service_is_one_line(here: Path, command: str, words: list[str]) -> None:
    service, *arguments = shlex.split(command)
    with pytest.raises(ConfigError) as caught:
        load(model_of(service), service, arguments)
    assert "\n" not in str(caught.value)
    assert_told(str(caught.value), words)


def test_there_are_two_hundred_of_them_over_all_commands() -> None:
    tables = (COMMANDS, VARIABLES, DEMO_VARIABLES, RECIPES, FLAGS)
    assert sum(len(rows(table)) for table in tables) >= 200
    tried = {" ".join(given.split()[:2]) for given, _ in rows(COMMANDS)}
    tried |= {given.split()[0] for given, _ in rows(COMMANDS)}
    # `check` lists what is wrong, a line each; `resume` is `pause`.
    left_out = {"world check", "sim resume", "topic", "world", "sim", "recordings", "markers",
                "keys", "security"}  # fmt: skip
    root: Any = typer.main.get_command(app)
    for name, command in root.commands.items():
        for path in (name, *(f"{name} {inner}" for inner in getattr(command, "commands", ()))):
            assert path in tried | left_out, path


def test_every_variable_in_docs_and_compose_is_known() -> None:
    pages = [ROOT / "README.md", ROOT / "docker-compose.yaml", *(ROOT / "docs").glob("*.md")]
    names = {
        name for page in pages for name in re.findall(r"\bMAZEBOT_[A-Z_]*[A-Z]\b", page.read_text())
    }
    assert "MAZEBOT_PHYSICS_SCAN_PROFILE" in names
    assert unknown_variable(sorted(names), fields_of_all()) == ""
