"""`imud replay`: recorded samples and fixes through the same filter as the daemon's, as fast as it goes."""

import argparse
from pathlib import Path

from ...errors import UsageError
from ..arguments import above_zero, add_settings, at_least_one, seconds
from ..files import input_file, refuse_overwriting


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("recordings", nargs="*", type=input_file, metavar="MCAP", help="recordings of imud; or:")
    parser.add_argument(
        "--imu", type=input_file, metavar="CSV", help="samples: t_s,gx_radps,…,az_mps2 (FRD); - for stdin"
    )
    parser.add_argument(
        "--gnss", type=input_file, metavar="CSV|NMEA", help="fixes: t_s,lat_deg,lon_deg,height_m,… or NMEA"
    )
    parser.add_argument(
        "--gnss-offset", type=seconds, metavar="S", help="added to the times of --gnss, whose clock is another one"
    )
    parser.add_argument(
        "--aiding", action="append", default=[], metavar="SOURCE=CSV", help="other measurements, as heading=hdg.csv"
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        required=True,
        metavar="CSV",
        help="estimates; - for stdout; of several recordings a folder",
    )
    parser.add_argument("--jobs", type=at_least_one, default=1, metavar="N", help="recordings at a time (default 1)")
    parser.add_argument("--cluster", metavar="ADDRESS", help="the same on the workers of a Dask scheduler: HOST:8786")
    parser.add_argument(
        "--innovations", type=Path, metavar="CSV", help="of fixes, rest and constraints, for `imud report`"
    )
    parser.add_argument(
        "--states", type=Path, metavar="CSV", help="each second: delays, mounting, scale, covariance, …; not smoothed"
    )
    parser.add_argument("--estimator", metavar="NAME", help="default: navigation with --gnss, else attitude")
    parser.add_argument("--initial", default="", metavar="KEY=V,…", help="known start: lat_deg=…,lon_deg=…,yaw_deg=…")
    parser.add_argument("--rate", type=above_zero, metavar="HZ", help="thin the output (default: every sample)")
    parser.add_argument("--smooth", action="store_true", help="estimates from the data before and after each sample")
    parser.add_argument("--calibration", type=Path, metavar="TOML", help="of the sensor, as `imud calibrate` keeps it")
    add_settings(parser)


def run(args: argparse.Namespace) -> int:
    aiding_files = (Path(text.partition("=")[2]) for text in args.aiding)
    inputs = [args.imu, args.gnss, args.calibration, args.config, *aiding_files, *args.recordings]
    refuse_overwriting([args.output, args.innovations, args.states], inputs)
    if args.recordings:
        if args.imu or args.gnss or args.aiding or args.gnss_offset is not None:
            of_tables = "--imu, --gnss, --gnss-offset and --aiding are for tables"
            raise UsageError(f"replay: {of_tables}: give tables or recordings, not both")
        if table := next((path for path in args.recordings if path.suffix.lower() == ".csv"), None):
            raise UsageError(f"replay: {table} is a table: --imu {table} if it has samples, --gnss if fixes")
        from . import recordings

        return recordings.run(args)
    if args.imu is None:
        raise UsageError("replay: name the recording: FILE.mcap, or --imu imu.csv [--gnss gnss.csv]")
    if args.cluster or args.jobs > 1:
        raise UsageError("replay: --cluster and --jobs are for recordings; tables are replayed here, by one process")
    if args.gnss_offset is not None and args.gnss is None:
        raise UsageError("replay: --gnss-offset is for the fixes of --gnss, which is missing")
    from ...tables.inputs import is_recording

    if recording := next((path for path in (args.imu, args.gnss) if path is not None and is_recording(path)), None):
        raise UsageError(f"replay: {recording} is a recording: name it without --imu and --gnss")
    from . import tables

    return tables.run(args)
