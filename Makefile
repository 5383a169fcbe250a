# Everything stays in this folder: .venv, out, .cache.
PYTHON ?= python3
VENV := .venv
ERTIS := $(VENV)/bin/ertis
STAMP := $(VENV)/.installed
# Shipped models: chirp=random scenes of either seed to learn from=of the one to be calibrated on=
# pings of drives without a landmark, 25200 an hour; 0 for none.
MODELS := hyperbolic:80000:20000:0.0025=16000=8000=25200 hyperbolic:50000:25000:0.0025=3000=3000=0
FUZZ_TARGETS := parser firmware frame mcap raw
FUZZ_S ?= 60

.PHONY: setup run test slow fuzz check bench models udev install uninstall clean

setup: $(STAMP)

# A virtual environment knows its folder by name: where the folder is another now, it is made anew.
ifneq "$(shell cat $(STAMP) 2>/dev/null)" "$(CURDIR)"
.PHONY: $(STAMP)
endif

$(STAMP): pyproject.toml
	@test ! -e $@ || test "$$(cat $@)" = "$(CURDIR)" || rm -rf $(VENV)
	@test -x $(VENV)/bin/pip || $(PYTHON) -m venv $(VENV) || { \
	  rm -rf $(VENV); \
	  echo "no virtual environment: install python3-venv (apt install python3-venv), then try again" >&2; \
	  exit 1; }
	$(VENV)/bin/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@printf '%s\n' "$(CURDIR)" > $@

run: setup
	@$(ERTIS) demo

# Rigs keep to a clock: they run after the other tests, one at a time.
test: setup
	$(VENV)/bin/python -m pytest -q -n logical --dist loadfile --ignore tests/rigs
	$(VENV)/bin/python -m pytest -q tests/rigs

# Needs: apt install qemu-system-x86 busybox-static cpio kmod
slow: setup
	$(VENV)/bin/python -m pytest -q -m slow

check: setup
	PATH="$(CURDIR)/$(VENV)/bin:$$PATH" ./check

bench: setup
	$(VENV)/bin/python tests/bench/bench.py

# FUZZ_S seconds in all; corpus and failing inputs stay in out/fuzz.
fuzz: setup
	for target in $(FUZZ_TARGETS); do \
	  $(VENV)/bin/python tests/fuzz/fuzz.py $$target out/fuzz \
	    -max_total_time=$$(( $(FUZZ_S) / $(words $(FUZZ_TARGETS)) )) || exit 1; \
	done

# The shipped models, made again from nothing: simulated scenes (26 GB in out/), then training.
models: setup
	mkdir -p out
	set -e; for made in $(MODELS); do \
	  set -- $$(echo $$made | tr = ' '); chirp=$$1 learnt=$$2 kept=$$3 driven=$$4; \
	  rm -f out/random-*.mcap out/drives.mcap; \
	  for seed in 1 2 3; do \
	    case $$seed in 3) n=$$kept;; *) n=$$learnt;; esac; \
	    $(ERTIS) simulate --random --seed $$seed -n $$n --chirp $$chirp -o out/random-$$seed.mcap; \
	  done; \
	  $(ERTIS) train out/random-1.mcap out/random-2.mcap --calibrate out/random-3.mcap \
	    -o detector/ertis_detector/models; \
	  test $$driven = 0 && continue; rm -f out/random-*.mcap; \
	  $(ERTIS) simulate --drives --seed 4 -n $$driven --chirp $$chirp -o out/drives.mcap; \
	  model=detector/ertis_detector/models/$$(echo $$chirp | tr : _).safetensors; \
	  $(ERTIS) calibrate --drives out/drives.mcap --model $$model -o $$model; \
	done; rm -f out/random-*.mcap out/drives.mcap

# Lets the group dialout open the sonar, and names it /dev/ertis-SERIALNUMBER: sudo make udev
udev:
	install -D -m 644 udev/70-ertis.rules $(DESTDIR)/etc/udev/rules.d/70-ertis.rules
ifeq ($(DESTDIR),)
	udevadm control --reload
	udevadm trigger --subsystem-match=usb --subsystem-match=tty
endif

# The daemon as a service, see docs/install.md: sudo make install; DESTDIR= stages it for a package
install uninstall: export PYTHON := $(PYTHON)
install uninstall: export DESTDIR := $(DESTDIR)
install uninstall:
	@daemon/systemd/install.sh $@

clean:
	rm -rf $(VENV) out .cache .mypy_cache .ruff_cache .pytest_cache .hypothesis
