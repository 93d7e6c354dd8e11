/*
 * Written by ftcal. Law: w = C r + o + k (T - T_ref), force [N] then torque [Nm].
 * SENSOR_wrench(x, w) computes w = M x + o, and + k (T - T_ref) where SENSOR_per_kelvin stands.
 * ftcal-provenance {"ftcal": "0.0.0", "calibration": "calibration.json", "sha256": "0123abcd", "created": "2026-01-02T03:04:05+00:00", "calibrated_with": "0.0.0", "robot": "iCubPretend", "undo": false}
 * ftcal-sensor {"sensor": "r_leg_ft_sensor", "signal": "right_leg/analog:o", "frame": "r_hip_3", "acts_on": "r_hip_2", "verdicts": {"fx": "ACCEPT", "fy": "ACCEPT", "fz": "ACCEPT", "tx": "ACCEPT", "ty": "ACCEPT", "tz": "ACCEPT"}, "keeps_workbench": [], "offset_of": "last 1.0-30.0 s", "temperature_signal": "right_leg/temperature:o", "envelope": {"fx": [-32.0, 64.0], "fy": [-32.0, 64.0], "fz": [-32.0, 64.0], "tx": [-4.0, 2.0], "ty": [-4.0, 2.0], "tz": [-4.0, 2.0], "force": [1.0, 100.0], "torque": [0.1, 7.0]}, "workbench": "SN900", "logged": "wrench", "workbench_gain": [[0.0, 0.0, 0.03125, 0.0, 0.0, 0.0], [0.03125, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0, 0.03125, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 0.0, 0.0009765625], [0.0, 0.0, 0.0, 0.0009765625, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 0.0009765625, 0.0]], "full_scale": [2048.0, 2048.0, 2048.0, 64.0, 64.0, 64.0]}
 */
#ifndef FTCAL_ICUBPRETEND_H
#define FTCAL_ICUBPRETEND_H

/* x: wrench as the sensor's board sends it, C_w r [N, Nm]; M is S = C C_w^-1 */
static const double r_leg_ft_sensor_matrix[6][6] = {
  {1.0, 0.0, 0.0, 0.25, 0.0, 0.0},
  {0.0, 0.5, 0.0, 0.0, 0.0, -0.5},
  {0.0, 0.0, 2.0, 0.0, 4.0, 0.0},
  {0.0, 0.0, 0.0, 1.0, 0.0, 0.0},
  {0.0, 0.0, 0.0, 0.0, 2.0, 0.0},
  {0.0, 0.0, 0.0, 0.0, 0.0, 1.0}};
static const double r_leg_ft_sensor_offset[6] = {20.0, -4.0, 64.0, 1.5, -0.25, 0.0};
static const double r_leg_ft_sensor_per_kelvin[6] = {0.5, -0.25, 2.0, 0.0, 0.125, -0.5};
static const double r_leg_ft_sensor_reference_temperature = 30.0;
static inline void r_leg_ft_sensor_wrench(const double x[6], double temperature, double w[6])
{
  for (int i = 0; i < 6; ++i) {
    w[i] = r_leg_ft_sensor_offset[i] + r_leg_ft_sensor_per_kelvin[i] * (temperature - r_leg_ft_sensor_reference_temperature);
    for (int j = 0; j < 6; ++j)
      w[i] += r_leg_ft_sensor_matrix[i][j] * x[j];
  }
}

#endif /* FTCAL_ICUBPRETEND_H */
