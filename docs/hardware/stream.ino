// Streams accelerometers at 1 kHz over USB, a line for each sample: time_s,a0_vx,a0_vy,a0_vz (s, V); or
// shorter frames, with a checksum, for `--format cobs`.
// For boards with the Arduino functions, a 12-bit converter and a crystal (Teensy 4.0 and its like).

const int PINS[] = {A0, A1, A2};  // x, y, z of a0; three more for each further accelerometer
const int CHANNELS = sizeof(PINS) / sizeof(PINS[0]);
const unsigned long RATE_HZ = 1000;    // sample_rate_hz in sensor.toml
const unsigned long STEP_US = 1000000 / RATE_HZ;
const double CLOCK = 1.0;              // true seconds in a second of the board's clock
const unsigned long FULL_UV = 3300000;  // the converter's reference, which also feeds the accelerometer, in uV
const bool FRAMES = false;             // in place of lines
const int READS = 8;                   // averaged, for a finer step than the converter's

unsigned long sample;
uint32_t begun_us, due_us;  // as wide as micros(), which overflows after 71 minutes

void setup() {
  Serial.begin(1000000);
  analogReadResolution(12);
  begun_us = due_us = micros();
}

unsigned long microvolts(int channel) {
  unsigned long sum = 0;
  for (int n = 0; n < READS; n++) sum += analogRead(PINS[channel]);
  return (unsigned long long)sum * FULL_UV / (4096UL * READS);
}

void sendLine() {
  char line[14 + 9 * CHANNELS];
  int end = snprintf(line, sizeof line, "%lu.%06lu", sample / RATE_HZ, sample % RATE_HZ * STEP_US);
  for (int channel = 0; channel < CHANNELS; channel++) {
    unsigned long uv = microvolts(channel);
    end += snprintf(line + end, sizeof line - end, ",%lu.%06lu", uv / 1000000, uv % 1000000);
  }
  Serial.println(line);
}

// Little-endian float64 time, float32 volts and the CRC-16 (XMODEM) of these; each zero becomes the distance to the next.
void sendFrame() {
  uint8_t bytes[8 + 4 * CHANNELS + 2], frame[sizeof bytes + 2];
  double time_s = sample / (double)RATE_HZ;
  memcpy(bytes, &time_s, 8);
  for (int channel = 0; channel < CHANNELS; channel++) {
    float volts = microvolts(channel) / 1e6f;
    memcpy(bytes + 8 + 4 * channel, &volts, 4);
  }
  uint16_t crc = 0;
  for (unsigned n = 0; n < sizeof bytes - 2; n++) {
    crc ^= bytes[n] << 8;
    for (int bit = 0; bit < 8; bit++) crc = crc & 0x8000 ? (crc << 1) ^ 0x1021 : crc << 1;
  }
  bytes[sizeof bytes - 2] = crc & 0xFF;
  bytes[sizeof bytes - 1] = crc >> 8;
  unsigned mark = 0;
  for (unsigned n = 0; n < sizeof bytes; n++) {
    frame[n + 1] = bytes[n];
    if (bytes[n] == 0) {
      frame[mark] = n + 1 - mark;
      mark = n + 1;
    }
  }
  frame[mark] = sizeof bytes + 1 - mark;
  frame[sizeof frame - 1] = 0;
  Serial.write(frame, sizeof frame);
}

void loop() {
  if ((int32_t)(micros() - due_us) < 0) return;
  if (FRAMES) sendFrame(); else sendLine();
  // A sample that came too late to be taken leaves a gap in the times, which 'softslide record' sees.
  do {
    sample++;
    due_us = begun_us + (uint32_t)(uint64_t)(sample * (STEP_US / CLOCK));
  } while ((int32_t)(micros() - due_us) > (int32_t)STEP_US);
}
