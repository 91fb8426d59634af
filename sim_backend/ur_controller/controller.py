"""The emulated controller: one tick of 2 ms after another, of programs, safety, motion and arm.

It runs on one thread and never waits: whoever owns it calls `tick`, and everything else in between. What the network
sees of it is made by the services of `server`.
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
"""Ticks that the controller says to have run when it is made: clients wait for a timestamp of 40 s."""

EXTERNAL_SENSOR_HZ = 10.0

_TICKS_PER_S = round(1.0 / TICK_S)
_MOVING_MODES = (SafetyMode.NORMAL, SafetyMode.REDUCED, SafetyMode.SAFEGUARD_STOP)  # in the last to come to rest


class Controller:
    """One e-Series controller with its arm.

    Commands return at once, and raise `Refused` with the text that the real controller gives. What takes time goes on
    in the ticks that follow.

    Args:
        plant: the arm, its tool and what they touch.
        make_builtins: binds the builtins that scripts may call to this controller; called once it is complete.
        durations: of powering on and the like.

    Attributes:
        plant: as given.
        motion: where the arm is told to be.
        safety: power and reasons to stand still.
        inputs: what RTDE clients have written.
        output_registers: what programs have written for them.
        terminals: digital and analog inputs and outputs.
        sockets: those that programs have opened.
        time_s: of the last tick, exactly on the grid of 2 ms.
        interpreter: of the programs that run.
        programs: text of the programs that can be loaded, by file name.
        loaded_program: file name of the one that `play` runs, or None.
        remote_control: the robot is in remote control, not in local.
        remote_control_enabled: the function is switched on in the settings.
        speed_slider: 0 … 1.
        temperature_c: of everything that has one.
        popup: the message of a program on the screen, or None.
        gravity: (3,) acceleration that programs have configured, m/s²; reported, and without effect.
        versions: major, minor, bugfix, build of the software that it says to be.
        serial: number, as text.
        robot_type: UR's number of the UR3.
        events: hear of everything that happens, in order.
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
        """Whether the network may command: in remote control, or where that function is switched off."""
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
        """The program that runs now: while a builtin is called, the one that calls it."""
        return self.interpreter.execution

    @property
    def program_name(self) -> str:
        """Of the main program, or of the last one."""
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
        """Take one RTDE package of inputs; it takes effect with the latency of the episode.

        Args:
            names: of RTDE inputs.
            values: as many, of the fields' types; any bits, NaN included.
        """
        self.inputs.receive(names, values, self._tick + self.plant.input_delay)

    def set_speed_slider(self, fraction: float) -> None:
        """Set the speed of programs, 0 … 1; what lies outside counts as the nearer end, NaN as nothing."""
        if fraction == fraction:
            self.speed_slider = min(max(fraction, 0.0), 1.0)

    def emit(self, event: Event) -> None:
        """Tell every listener."""
        for listener in self.events:
            listener(event)

    def use_external_sensor(self, lever: Sequence[float] | None) -> None:
        """Take forces from `external_force_torque` of RTDE instead of the built-in sensor, or from that one again.

        Where no watchdog is set, one watches over that input, at 10 Hz, as on the real controller.

        Args:
            lever: (3,) where the external sensor measures, in the flange's frame, m; None for the built-in one.
        """
        self._external_lever = lever
        if lever is None:
            self.plant.external_wrench = None
        elif not self.inputs.watchdogs:
            self.inputs.watch("external_force_torque", EXTERNAL_SENSOR_HZ, "pause")

    def close(self) -> None:
        """End the programs and close what they have opened."""
        self.interpreter.stop_all()
        self.sockets.close_all()

    # --- power and safety ---

    def power_on(self) -> None:
        """Power the joints; ends in IDLE after a while. Without effect where they have power, or must not."""
        self.safety.power_on()

    def power_off(self) -> None:
        """Take the power from the joints."""
        self.safety.power_off()
        self._halt()

    def brake_release(self) -> None:
        """Release the brakes, powering on before where needed; ends in RUNNING after a while."""
        self.safety.brake_release()

    def unlock_protective_stop(self, *, at_once: bool = False) -> None:
        """Leave the protective stop.

        Args:
            at_once: as the script ports do it; the dashboard and the pendant wait for 5 s.

        Raises:
            Refused: earlier than 5 s after it.
        """
        if not self.safety.unlock_protective_stop(at_once=at_once):
            raise Refused(UNLOCK_TOO_EARLY)

    def close_safety_popup(self) -> None:
        """Close the message about the last stop; nothing waits for it here."""

    def restart_safety(self) -> None:
        """Restart the safety system, out of a violation or a fault as well; ends powered off."""
        self.safety.restart()
        self._halt()

    def press_emergency_stop(self, *, system: bool = False) -> None:
        """Press the robot's emergency stop, or the system's."""
        self.safety.press_emergency_stop(system=system)
        self._halt()

    def release_emergency_stop(self) -> None:
        """Release it; the robot stays without power until it is powered on."""
        self.safety.release_emergency_stop()

    def open_safeguard(self) -> None:
        """Open the safeguard: the program pauses."""
        self.safety.open_safeguard()
        if self.interpreter.runs:
            self._paused_by_safeguard = True
            self.interpreter.pause()

    def close_safeguard(self) -> None:
        """Close the safeguard: a program that it has paused goes on."""
        self.safety.close_safeguard()
        if self._paused_by_safeguard and self.safety.may_move:
            self.interpreter.resume()
        self._paused_by_safeguard = False

    def protective_stop(self, reason: str) -> None:
        """Stop at once and end the program; programs may call it too."""
        self.safety.protective_stop(reason)
        self._halt()

    def violate(self, reason: str) -> None:
        """Trip a safety limit: stop, without power, until safety is restarted."""
        self.safety.violate(reason)
        self._halt()

    def fault(self, reason: str) -> None:
        """Fail: stop, without power, until safety is restarted."""
        self.safety.fault(reason)
        self._halt()

    # --- programs ---

    def run_script(self, text: str) -> None:
        """Compile a script and run it: a program in place of the one that runs, a secondary one beside it.

        What is wrong with the text is an event (`CompileFailed`), not an exception; the running program goes on then.

        Raises:
            Refused: a program, and the robot is not running; too many secondary programs.
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

    def load(self, name: str) -> None:
        """Choose the program that `play` runs.

        Raises:
            Refused: there is none of that name, or one runs.
        """
        if name not in self.programs:
            raise Refused(f"File not found: {name}")
        if self.interpreter.is_busy:
            raise Refused(f"Error while loading program: {name}")
        self.loaded_program = name

    def play(self) -> None:
        """Run the loaded program, or go on with a paused one.

        Raises:
            Refused: neither, or the robot is not running.
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
        """Let the program and its motion come to rest; `play` goes on.

        Raises:
            Refused: no program runs.
        """
        if not self.interpreter.runs:
            raise Refused("Failed to execute: pause")
        self.interpreter.pause()

    def stop_program(self) -> None:
        """End the program; the arm decelerates. Nothing without a program."""
        self.interpreter.stop()

    def show(self, popup: Popup) -> None:
        """Show a program's message on the screen."""
        self.popup = popup
        self.emit(popup)

    def close_popup(self) -> None:
        """Close the message on the screen; a program that waits for it goes on."""
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
        """Make the next joint target; what was on its way before a stop does not go on after it."""
        if self.safety.robot_mode is RobotMode.RUNNING and self.safety.safety_mode in _MOVING_MODES:
            if not self._enabled:
                self.motion.freeze()
                self._enabled = True
            halted = self.interpreter.is_paused or not self.safety.may_move
            self.motion.advance(0.0 if halted else self.speed_slider)
        else:
            self._enabled = False

    def _protect(self) -> None:
        """The arm's own protection, and what a motion that cannot go on leads to."""
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
        """Carry the external sensor's wrench to the flange."""
        force, moment = self.inputs.external_wrench[:3], self.inputs.external_wrench[3:]
        turned = cross(self._external_lever or (0.0, 0.0, 0.0), force)
        self.plant.external_wrench = (*force, *(a + b for a, b in zip(moment, turned, strict=True)))

    def _halt(self) -> None:
        """Stop at once; the programs end, after its present step the one that has asked for it itself."""
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
