"""A pose record as a reader gets it, for what shows it."""

from mavkf.estimate import Mode, Pose, Validity

POSE = Pose(
    vehicle="1-1",
    session=0,
    seq=7,
    lat_deg=47.3977421,
    lon_deg=8.5455939,
    alt_amsl_m=488.25,
    euler_deg=(1.0, -2.0, None),
    pose_covariance=(9.0, *(0.0,) * 6, 16.0, *(0.0,) * 6, 0.25, *(None,) * 21),
    valid=Validity(position=True, tilt=True),
    mode=Mode.NAVIGATING,
    flags=("still",),
)
