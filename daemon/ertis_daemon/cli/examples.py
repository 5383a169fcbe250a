"""An example for the help of each command that does not bring its own."""

EXAMPLES: dict[str, str] = {
    "run": "ertis run --config /etc/ertis/ertis.yaml",
    "check-config": "ertis check-config ertis.yaml",
    "monitor": "ertis monitor --connect tcp/robot:7447",
    "devices": "ertis devices --json",
    "emulate": "ertis emulate --scene hall.yaml --link ertis0",
    "probe": "ertis probe serial:/dev/ttyACM0",
    "detect": "ertis detect garage.mcap",
    "record": "ertis record hall.mcap -t 30s --who Ada --where hall",
    "info": "ertis info hall.mcap --check",
    "recover": "ertis recover torn.mcap",
    "replay": "ertis replay hall.mcap --rate 2 --loop",
    "convert": "ertis convert hall.mcap hall.wav",
    "evaluate": "ertis evaluate sonar-data --html page.html",
    "simulate": "ertis simulate --dataset sonar-data --seed 1 -n 70",
    "validate": "ertis validate",
    "train": "ertis train training.mcap -o model.safetensors",
    "calibrate": "ertis calibrate sonar-data -o here.safetensors",
    "dataset": "ertis dataset check sonar-data",
    "demo": "ertis demo --seconds 10",
}
