// Prints  time_ms,pressure_kpa,force_n*hh  a hundred times a second, and takes  P=250.0
//
// A pressure transmitter on A0, a force amplifier on A1, a pressure regulator on the PWM output 9
// (through a filter to 0..10 V). Change the numbers below to those of your sensors.
//
// This sketch lets the air out when no line came from the computer for two seconds. That is a
// courtesy, not a safety contract: nothing watches the sketch itself.

const int PRESSURE_PIN = A0, FORCE_PIN = A1, REGULATOR_PIN = 9;
const float KPA_PER_COUNT = 1000.0 / 1023.0, NEWTON_PER_COUNT = 200.0 / 1023.0;
const float HIGHEST_KPA = 600.0, REGULATOR_KPA = 1000.0;
const unsigned long PERIOD_MS = 10, SILENCE_MS = 2000;

unsigned long due_ms = 0, heard_ms = 0;
char line[24];
byte used = 0;

void show(const char *text) {
  byte sum = 0;
  for (const char *c = text; *c; ++c) sum ^= *c;
  char end[4];
  snprintf(end, sizeof end, "*%02X", sum);
  Serial.print(text);
  Serial.println(end);
}

void set_pressure(float kpa) {
  kpa = constrain(kpa, 0.0, HIGHEST_KPA);
  analogWrite(REGULATOR_PIN, (int)(255.0 * kpa / REGULATOR_KPA + 0.5));
  char text[24], number[12];
  dtostrf(kpa, 1, 1, number);
  snprintf(text, sizeof text, "# P=%s", number);
  show(text);
}

void hear(char c) {
  if (c == '\n') {
    line[used] = 0;
    used = 0;
    if (line[0] == 'P' && line[1] == '=') {
      heard_ms = millis();
      set_pressure(atof(line + 2));
    }
  } else if (used < sizeof line - 1) {
    line[used++] = c;
  }
}

void setup() {
  Serial.begin(115200);
  analogWrite(REGULATOR_PIN, 0);
}

void loop() {
  while (Serial.available()) hear(Serial.read());
  unsigned long now = millis();
  if (heard_ms && now - heard_ms > SILENCE_MS) {
    heard_ms = 0;
    set_pressure(0.0);
  }
  if (now - due_ms < PERIOD_MS) return;
  due_ms = now;
  char text[48], kpa[12], newton[12];
  dtostrf(analogRead(PRESSURE_PIN) * KPA_PER_COUNT, 1, 2, kpa);
  dtostrf(analogRead(FORCE_PIN) * NEWTON_PER_COUNT, 1, 3, newton);
  snprintf(text, sizeof text, "%lu,%s,%s", now, kpa, newton);
  show(text);
}
