// Streams accelerometers at 1 kHz over USB, a line for each sample: time_s,a0_vx,a0_vy,a0_vz (s, V).
// For boards with the Arduino functions, a 12-bit converter and a crystal (Teensy 4.0 and its like).

const int PINS[] = {A0, A1, A2};  // x, y, z of a0; three more for each further accelerometer
const int CHANNELS = sizeof(PINS) / sizeof(PINS[0]);
const unsigned long RATE_HZ = 1000;    // sample_rate_hz in sensor.toml
const unsigned long STEP_US = 1000000 / RATE_HZ;
const unsigned long FULL_UV = 3300000;  // the converter's reference, which also feeds the accelerometer, in uV
const int READS = 8;                   // averaged, for a finer step than the converter's

unsigned long sample;
uint32_t due_us;  // as wide as micros(), which overflows after 71 minutes

void setup() {
  Serial.begin(1000000);
  analogReadResolution(12);
  due_us = micros();
}

void loop() {
  if ((int32_t)(micros() - due_us) < 0) return;
  char line[14 + 9 * CHANNELS];
  int end = snprintf(line, sizeof line, "%lu.%06lu", sample / RATE_HZ, sample % RATE_HZ * STEP_US);
  for (int channel = 0; channel < CHANNELS; channel++) {
    unsigned long sum = 0;
    for (int n = 0; n < READS; n++) sum += analogRead(PINS[channel]);
    unsigned long uv = (unsigned long long)sum * FULL_UV / (4096UL * READS);
    end += snprintf(line + end, sizeof line - end, ",%lu.%06lu", uv / 1000000, uv % 1000000);
  }
  Serial.println(line);
  // A sample that came too late to be taken leaves a gap in the times, which 'softslide record' sees.
  do { sample++; due_us += STEP_US; } while ((int32_t)(micros() - due_us) > (int32_t)STEP_US);
}
