"""The emulated controller: programs, safety, motion and arm, in ticks of 2 ms.

It runs on one thread and never waits. Its owner calls `tick`, and all other methods between ticks. The services of
`server` present it to the network.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from sim_backend.ur_controller.events import (
    CompileFailed,
    Event,
    Listener,
    Popup,
    Refused,
    SafetyChanged,
    Text,
)
from sim_backend.ur_controller.geometry import cross
from sim_backend.ur_controller.inputs import Inputs, Registers
from sim_backend.ur_controller.interpreter import Interpreter
from sim_backend.ur_controller.motion import Motion
from sim_backend.ur_controller.plant import Plant
from sim_backend.ur_controller.safety import UNLOCK_TOO_EARLY, Durations, Safety
from sim_backend.ur_controller.script import Builtin, CompileError, Execution, compile_source
from sim_backend.ur_controller.sockets import Sockets
from sim_backend.ur_controller.terminals import Terminals
from sim_backend.world.arm import PROTECTIVE_ERROR_RAD, PROTECTIVE_FORCE_N
from wire.records import TICK_S
from wire.rtde.modes import RobotMode, RuntimeState, SafetyMode

START_TICK = 30_000
"""Ticks at the controller's creation; the number is positive because clients wait for a timestamp of 40 s."""

EXTERNAL_SENSOR_HZ = 10.0

_TICKS_PER_S = round(1.0 / TICK_S)
_MOVING_MODES = (SafetyMode.NORMAL, SafetyMode.REDUCED, SafetyMode.SAFEGUARD_STOP)  # SAFEGUARD_STOP moves until at rest


class Controller:
    """One e-Series controller with its arm.

    Commands return at once and raise `Refused` with the real controller's text. Work that takes time continues in the
    following ticks.

    Args:
        plant: arm, its tool and the objects they touch.
        make_builtins: returns the script builtins bound to this controller; called last in the constructor.
        durations: durations of powering on and similar steps.

    Attributes:
        plant: as given.
        motion: commanded motion of the arm.
        safety: power and reasons to stand still.
        inputs: inputs written by RTDE clients.
        output_registers: registers that programs write for RTDE clients.
        terminals: digital and analog inputs and outputs.
        sockets: connections that programs have opened.
        time_s: time of the last tick, s, exactly on the grid of 2 ms.
        interpreter: interpreter of the running programs.
        programs: text of each loadable program by file name.
        loaded_program: file name of the program that `play` runs, or None.
        remote_control: True in remote control, False in local control.
        remote_control_enabled: remote control is enabled in the settings.
        speed_slider: fraction of the programs' speed, 0 … 1.
        temperature_c: temperature of every component that reports one.
        popup: a program's message on the screen, or None.
        gravity: (3,) acceleration configured by programs, m/s²; reported, but without effect.
        versions: reported software version: major, minor, bugfix, build.
        serial: reported serial number.
        robot_type: UR's type number of the UR3.
        events: listeners to all events, in order.
    """

    versions = (5, 21, 3, 1282)
    serial = "20235300042"
    robot_type = 3
    temperature_c = 30.0

    def __init__(
        self,
        plant: Plant,
        make_builtins: "Callable[[Controller], Mapping[str, Builtin]]",
        *,
        durations: Durations | None = None,
    ) -> None:
        self.plant = plant
        self.motion = Motion(plant)
        self.safety = Safety(durations or Durations(), self._safety_changed)
        self.terminals = Terminals()
        self.inputs = Inputs(self.terminals, self.set_speed_slider)
        self.output_registers = Registers()
        self.sockets = Sockets()
        self.time_s = START_TICK / _TICKS_PER_S
        self.interpreter = Interpreter(self.motion, self.emit, self._program_ended)
        self.programs: dict[str, str] = {}
        self.loaded_program: str | None = None
        self.remote_control = self.remote_control_enabled = True
        self.speed_slider = 1.0
        self.gravity = (0.0, 0.0, 9.82)
        self.events: list[Listener] = []
        self._tick = START_TICK
        self.popup: Popup | None = None
        self._paused_by_safeguard = False
        self._enabled = True
        self._external_lever: Sequence[float] | None = None
        self._last_target = self.motion.q_target
        self._builtins = make_builtins(self)
        plant.on_placed.append(self._placed)

    def tick(self) -> None:
        """Run one step of 2 ms: inputs, programs, watchdogs, safety, motion, arm."""
        self.inputs.apply_due(self._tick)
        if self._external_lever is not None:
            self._feed_external_sensor()
        self.interpreter.step()
        if self.inputs.watchdogs:
            self._watch()
        self.safety.tick()
        self._move()
        self._protect()
        self.plant.drive(self.motion.q_target, self.motion.qd_target)
        self._last_target = self.motion.q_target
        self.interpreter.settle(self.speed_slider)
        self._tick += 1
        self.time_s = self._tick / _TICKS_PER_S

    # --- what clients see and write ---

    @property
    def takes_commands(self) -> bool:
        """Network clients may command: the robot is in remote control, or remote control is disabled."""
        return self.remote_control or not self.remote_control_enabled

    @property
    def robot_mode(self) -> RobotMode:
        return self.safety.robot_mode

    @property
    def safety_mode(self) -> SafetyMode:
        return self.safety.safety_mode

    @property
    def runtime_state(self) -> RuntimeState:
        return self.interpreter.state

    @property
    def execution(self) -> Execution | None:
        """The running program; during the call of a builtin, the program that calls it."""
        return self.interpreter.execution

    @property
    def program_name(self) -> str:
        """Name of the main program, or of the last one."""
        return self.interpreter.name

    @property
    def safety_status_bits(self) -> int:
        """Bits 0–10 of RTDE's `safety_status_bits`."""
        return self.safety.status_bits

    @property
    def robot_status_bits(self) -> int:
        """Bits 0–3 of RTDE's `robot_status_bits`: power, program running, teach button, power button."""
        running = self.runtime_state not in (RuntimeState.STOPPED, RuntimeState.PAUSED)
        return int(self.safety.is_powered) | running << 1 | self.motion.in_freedrive << 2

    @property
    def control_step(self) -> int:
        """Number of the next tick."""
        return self._tick

    def apply_inputs(self, names: Sequence[str], values: Sequence[Any]) -> None:
        """Store one RTDE package of inputs; it takes effect after the latency of the episode.

        Args:
            names: names of RTDE inputs.
            values: one value per name, of the field's type; any bits, NaN included.
        """
        self.inputs.receive(names, values, self._tick + self.plant.next_delay())

    def set_speed_slider(self, fraction: float) -> None:
        """Set the speed of programs, 0 … 1; values outside are clamped, NaN is ignored."""
        if fraction == fraction:
            self.speed_slider = min(max(fraction, 0.0), 1.0)

    def emit(self, event: Event) -> None:
        """Pass an event to every listener."""
        for listener in self.events:
            listener(event)

    def use_external_sensor(self, lever: Sequence[float] | None) -> None:
        """Take forces from `external_force_torque` of RTDE, or from the built-in sensor again.

        Without another watchdog, one of 10 Hz watches over that input, as on the real controller.

        Args:
            lever: (3,) position of the external sensor in the flange's frame, m; None selects the built-in sensor.
        """
        self._external_lever = lever
        if lever is None:
            self.plant.external_wrench = None
        elif not self.inputs.watchdogs:
            self.inputs.watch("external_force_torque", EXTERNAL_SENSOR_HZ, "pause")

    def close(self) -> None:
        """End the programs and close their connections."""
        self.interpreter.stop_all()
        self.sockets.close_all()

    # --- power and safety ---

    def power_on(self) -> None:
        """Power the joints, which ends in IDLE after a while. No effect if they have power or must not get it."""
        self.safety.power_on()

    def power_off(self) -> None:
        """Remove power from the joints."""
        self.safety.power_off()
        self._halt()

    def brake_release(self) -> None:
        """Release the brakes, which ends in RUNNING after a while; power on first if needed."""
        self.safety.brake_release()

    def unlock_protective_stop(self, *, at_once: bool = False) -> None:
        """Leave the protective stop.

        Args:
            at_once: do not wait; the script ports unlock this way, the dashboard and the pendant wait for 5 s.

        Raises:
            Refused: the stop is younger than 5 s.
        """
        if not self.safety.unlock_protective_stop(at_once=at_once):
            raise Refused(UNLOCK_TOO_EARLY)

    def close_safety_popup(self) -> None:
        """Close the message about the last stop; the emulation waits for no such message."""

    def restart_safety(self) -> None:
        """Restart the safety system and power off; this also leaves a violation or a fault."""
        self.safety.restart()
        self._halt()

    def press_emergency_stop(self, *, system: bool = False) -> None:
        """Press the emergency stop of the robot, or of the system."""
        self.safety.press_emergency_stop(system=system)
        self._halt()

    def release_emergency_stop(self) -> None:
        """Release the emergency stop; the robot stays without power until it is powered on."""
        self.safety.release_emergency_stop()

    def open_safeguard(self) -> None:
        """Open the safeguard, which pauses the program."""
        self.safety.open_safeguard()
        if self.interpreter.runs:
            self._paused_by_safeguard = True
            self.interpreter.pause()

    def close_safeguard(self) -> None:
        """Close the safeguard; a program that it paused resumes."""
        self.safety.close_safeguard()
        if self._paused_by_safeguard and self.safety.may_move:
            self.interpreter.resume()
        self._paused_by_safeguard = False

    def protective_stop(self, reason: str) -> None:
        """Stop at once and pause the program; a program may call this too.

        The program stays paused when the stop is unlocked (script manual, `protective_stop`); `play` resumes it.
        """
        self.safety.protective_stop(reason)
        self.motion.freeze()
        self.interpreter.pause(at_once=True)
        self.interpreter.stop_secondaries()
        self._last_target = self.motion.q_target

    def violate(self, reason: str) -> None:
        """Trip a safety limit: stop and cut the power until safety is restarted."""
        self.safety.violate(reason)
        self._halt()

    def fault(self, reason: str) -> None:
        """Report a fault: stop and cut the power until safety is restarted."""
        self.safety.fault(reason)
        self._halt()

    # --- programs ---

    def run_script(self, text: str) -> None:
        """Compile a script and run it; a program replaces the running one, a secondary program runs beside it.

        An error in the text is an event (`CompileFailed`), not an exception; the running program then continues.

        Raises:
            Refused: the script is a program and the robot is not running, or too many secondary programs run.
        """
        try:
            compiled = compile_source(text, self._builtins)
        except CompileError as error:
            self.emit(CompileFailed(error.line, error.column, error.text))
            return
        if compiled.kind == "secondary":
            self.interpreter.start_secondary(compiled)
            return
        if not self.safety.may_move:
            raise Refused(
                f"a program cannot start while the robot is {self.robot_mode.name} and safety is"
                f" {self.safety_mode.name}; it has to be RUNNING and NORMAL"
            )
        self.interpreter.start(compiled)
        self.plant.zero_ft()  # as a real controller does whenever a program starts

    def load(self, name: str) -> None:
        """Select the program that `play` runs.

        Raises:
            Refused: there is no such program, or a program is running.
        """
        if name not in self.programs:
            raise Refused(f"File not found: {name}")
        if self.interpreter.is_busy:
            raise Refused(f"Error while loading program: {name}")
        self.loaded_program = name

    def play(self) -> None:
        """Run the loaded program, or resume a paused one.

        Raises:
            Refused: there is neither, or the robot is not running.
        """
        if not self.safety.may_move:
            raise Refused("Failed to execute: play")
        if self.interpreter.is_paused:
            self.interpreter.resume()
        elif not self.interpreter.is_busy and self.loaded_program is not None:
            self.run_script(self.programs[self.loaded_program])
        else:
            raise Refused("Failed to execute: play")

    def pause(self) -> None:
        """Bring the program and its motion to rest; `play` resumes.

        Raises:
            Refused: no program runs.
        """
        if not self.interpreter.runs:
            raise Refused("Failed to execute: pause")
        self.interpreter.pause()

    def stop_program(self) -> None:
        """End the program; the arm decelerates. No effect without a program."""
        self.interpreter.stop()

    def show(self, popup: Popup) -> None:
        """Show a program's message on the screen."""
        self.popup = popup
        self.emit(popup)

    def close_popup(self) -> None:
        """Close the message on the screen; a program that waits for it continues."""
        self.popup = None

    def _watch(self) -> None:
        starved = self.inputs.starved()
        if starved is None:
            return
        variable, action = starved
        self.emit(Text(f"RTDE watchdog: no package with {variable} in time, action {action}"))
        if action == "stop":
            self.stop_program()
        else:
            self.interpreter.pause()

    # --- the arm ---

    def _move(self) -> None:
        """Compute the next joint target; motion from before a stop does not resume after it."""
        if self.safety.robot_mode is RobotMode.RUNNING and self.safety.safety_mode in _MOVING_MODES:
            if not self._enabled:
                self.motion.freeze()
                self._enabled = True
            halted = self.interpreter.is_paused or not self.safety.may_move
            self.motion.advance(0.0 if halted else self.speed_slider)
        else:
            self._enabled = False

    def _protect(self) -> None:
        """Apply the arm's own protection, and stop for a motion that cannot continue."""
        motion, plant = self.motion, self.plant
        if self.safety.robot_mode is not RobotMode.RUNNING:
            return
        if motion.fault is not None:
            self.protective_stop(motion.fault)
        elif not math.isfinite(sum((motion.q_target + motion.qd_target).tolist())):
            self.violate("the joint target is not a number")
        elif not math.isfinite(sum(plant.wrench.tolist())):
            self.protective_stop("the wrench on the tool is not a number")
        elif plant.true_force > PROTECTIVE_FORCE_N:
            self.protective_stop(f"the tool carries more than {PROTECTIVE_FORCE_N:.0f} N")
        else:
            deviation = np.abs(plant.q - self._last_target)
            if deviation.max() > PROTECTIVE_ERROR_RAD:
                self.protective_stop(f"joint {int(deviation.argmax()) + 1} deviates from its path")

    def _feed_external_sensor(self) -> None:
        """Transform the external sensor's wrench to the flange."""
        force, moment = self.inputs.external_wrench[:3], self.inputs.external_wrench[3:]
        turned = cross(self._external_lever or (0.0, 0.0, 0.0), force)
        self.plant.external_wrench = (*force, *(a + b for a, b in zip(moment, turned, strict=True)))

    def _halt(self) -> None:
        """Stop at once and end the programs; a program that asked for the stop itself ends after its present step."""
        self.motion.freeze()
        self.interpreter.stop_all()
        self._last_target = self.motion.q_target

    def _placed(self) -> None:
        self.motion.freeze()
        self.inputs.forget_latency()
        self._last_target = self.motion.q_target

    def _program_ended(self) -> None:
        self.inputs.watchdogs.clear()
        self.sockets.close_all()
        self._paused_by_safeguard = False
        if self.popup is not None and self.popup.blocking:
            self.popup = None

    def _safety_changed(self, mode: SafetyMode, reason: str) -> None:
        self.emit(SafetyChanged(mode, reason))
