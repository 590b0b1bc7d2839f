"""Choices that follow from the settings, and from the sensor that was found: ports, estimator, noise profile."""

import os
from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace

import msgspec

from imud.drivers.driver import Identity, ImuConfigured, Options
from imud.drivers.errors import PortAbsentError, SpecError
from imud.drivers.transport.portspec import PortSpec
from imud.drivers.transport.pps import PulsePerSecond

from ..configuration.settings import Settings
from ..errors import DeviceAbsentError, UsageError
from ..estimators import Estimator, registry
from ..sensor_errors.profiles import DEFAULT, PROFILES

RECORDED = "replay:"  # begins a port that a recording plays; several may play one file
NO_GYRO_ESTIMATOR = "tilt"  # the estimator for sensors that lack them
ONE_GYRO_ESTIMATOR = "riss"  # for those that have the one about z, beside a receiver
ONE_GYRO = (False, False, True)


def ports(settings: Settings) -> list[tuple[PortSpec, Options]]:
    """Each port with the options for the device on it. Raises UsageError."""
    imu, gnss = settings.imu, settings.gnss
    options = Options(
        model=imu.model,
        rate_hz=imu.rate_hz,
        polled=imu.mode == "polled",
        filter_taps=imu.filter_taps,
        self_test=imu.self_test,
        unchecked=not gnss.require_checksum,
        fix_rate_hz=gnss.rate_hz,
        set_up_nmea=gnss.configure,
    )
    specs = [_spec(text, settings) for text in settings.ports]
    _refuse_twice(specs)
    readonly = _readonly(settings.readonly, [spec.path for spec in specs])
    return [(spec, _options_of(spec, options, readonly)) for spec in specs]


def _refuse_twice(specs: Iterable[PortSpec]) -> None:
    """Raises UsageError where two of them are one device, perhaps by a link such as /dev/serial/by-id/…."""
    named: dict[str, str] = {}
    for spec in specs:
        recorded = spec.path.startswith(RECORDED)
        name = str(spec) if recorded else spec.path
        device = name if recorded else os.path.realpath(name)
        if device in named:
            also = "" if name == named[device] else f", also as {name}"
            raise UsageError(f"port {named[device]} is named twice{also}")
        named[device] = name


def _options_of(spec: PortSpec, options: Options, readonly: Collection[str]) -> Options:
    """The options, with what the port itself says."""
    device = spec.server[2] if spec.server else ""
    return replace(options, readonly=spec.path in readonly, keep_baud=spec.baud is not None, device=device)


def _spec(text: str, settings: Settings) -> PortSpec:
    try:
        spec = PortSpec.parse(text)
        return replace(spec, data_ready=settings.spi.data_ready or None) if spec.spi else spec
    except SpecError as error:
        raise UsageError(str(error)) from error


def _readonly(wanted: bool | tuple[str, ...], paths: list[str]) -> Collection[str]:
    """The ports to which nothing is written."""
    if isinstance(wanted, bool):
        return paths if wanted else ()
    if unknown := [path for path in wanted if path not in paths]:
        raise UsageError(f"readonly names {', '.join(unknown)}, but the ports are {', '.join(paths)}")
    return wanted


def pulse(settings: Settings) -> PulsePerSecond | None:
    """The receiver's pulse per second, if the settings name one. Raises DeviceAbsentError."""
    try:
        return PulsePerSecond(settings.gnss.pps) if settings.gnss.pps else None
    except PortAbsentError as error:
        raise DeviceAbsentError(str(error)) from error


@dataclass(frozen=True)
class Choice:
    """The estimator that is wanted, and the names of those that may take its place if the user left the choice to us.

    with_one_gyro: for a sensor that has the one about z; None: as for one without any.
    """

    wanted: Estimator
    fallback: str | None
    with_one_gyro: str | None = None

    @property
    def possible(self) -> list[str]:
        """The names of all."""
        return [each for each in (self.wanted.name, self.fallback, self.with_one_gyro) if each]

    def estimator_for(self, sensor: ImuConfigured) -> tuple[Estimator, str]:
        """The estimator for which this sensor suffices; if it is not the wanted one, also why. Raises UsageError."""
        if all(sensor.gyro_axes) or not self.wanted.needs_gyros:
            return self.wanted, ""
        missing = ", ".join(axis for axis, there in zip("xyz", sensor.gyro_axes, strict=True) if not there)
        device = sensor.identity.model or sensor.identity.driver
        if self.fallback is None:
            other = f" or {ONE_GYRO_ESTIMATOR}" if sensor.gyro_axes == ONE_GYRO else ""
            raise UsageError(
                f"the estimator {self.wanted.name!r} needs all gyros, and {device} has none about {missing}: "
                f"choose --estimator {NO_GYRO_ESTIMATOR}{other}, or leave the choice to imud"
            )
        instead = registry.by_name((self.with_one_gyro if sensor.gyro_axes == ONE_GYRO else None) or self.fallback)
        return instead, f"{device} has no gyro about {missing}: {instead.name} instead of {self.wanted.name}"


def estimators(settings: Settings) -> Choice:
    """What the user asked for; else by whether a receiver may be there. Raises UsageError."""
    if settings.aiding.magnetometer:
        from ..estimators import earth_field

        earth_field.check()
    if settings.estimator != "auto":
        return Choice(registry.by_name(settings.estimator), None)
    if len(settings.ports) > 1:
        return Choice(registry.by_name("navigation"), NO_GYRO_ESTIMATOR, ONE_GYRO_ESTIMATOR)
    return Choice(registry.by_name("attitude"), NO_GYRO_ESTIMATOR)


def unknown_profile(settings: Settings, identity: Identity) -> str:
    """A message if the sensor's driver, a plug-in, names a noise profile that does not exist; else empty."""
    if settings.imu.profile != "auto" or identity.profile in ("", *PROFILES):
        return ""
    return (
        f"the driver {identity.driver} names the noise profile {identity.profile!r}, which there is not: {DEFAULT} is "
        f"assumed; set imu.profile or [noise]; there are {', '.join(PROFILES)}"
    )


def settings_for(settings: Settings, identity: Identity, port: int) -> Settings:
    """Settings with profile and mounting of the sensor that was found on the port of that number.

    The profile is the sensor's own unless the user chose one.
    """
    imu = settings.imu
    if imu.profile == "auto" and identity.profile in PROFILES:
        imu = msgspec.structs.replace(imu, profile=identity.profile)
    path = _spec(settings.ports[port], settings).path if imu.mounts and port < len(settings.ports) else ""
    for name in (identity.serial, path):
        if name in imu.mounts:
            imu = msgspec.structs.replace(imu, mount_rpy_deg=imu.mounts[name])
            break
    return msgspec.structs.replace(settings, imu=imu)
