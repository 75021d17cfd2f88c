// The whole sketch on a computer: the Arduino core of arduino/, and a model of the ADS1256 that was
// written from its data sheet (SBAS288K: pages 7 timing, 20 multiplexing, 30 registers, 34 commands).
#include "arduino/Arduino.h"
#include "arduino/Encoder.h"
#include "arduino/SPI.h"

#include <string.h>

namespace {

constexpr uint8_t kPins = 40, kChipSelect = 10, kDataReady = 9;
constexpr double kClockUs = 1.0 / 7.68;    // period of the converter's clock
constexpr uint32_t kCalibrationUs = 700;   // at 30 kSPS and gain 64
constexpr uint32_t kSettledUs = 229;       // from WAKEUP to DRDY at 30 kSPS

uint64_t now_ns = 0;
uint8_t pins[kPins], modes[kPins];
int power[kPins];
int32_t encoder_counts[kPins];
unsigned violations = 0;

// Input of the converter: the difference of two pins, in counts of the gain that is set.
class Ads1256 {
 public:
  int32_t inputs[8] = {};  // [counts] at gain 64
  uint8_t registers[11] = {0x30, 0x01, 0x20, 0xF0, 0xE0, 0, 0, 0, 0, 0, 0};
  bool present = true;
  unsigned misuse = 0;  // commands while it calibrates, or too early

  bool ready() {
    advance();
    return present && ready_;
  }

  void select() { count_ = 0, command_ = 0, answering_ = 0; }

  uint8_t transfer(uint8_t in) {
    if (!present) return 0xFF;
    advance();
    const double gap_us = static_cast<double>(now_ns - last_ns_) * 1e-3;
    if (answering_ > 0) {
      if (answering_ == 3 && gap_us < 50 * kClockUs) ++misuse;  // t6
      return static_cast<uint8_t>(output_ >> (8 * --answering_));
    }
    if (calibrates()) ++misuse;
    if (count_ == 0) return command(in, gap_us);
    return argument(in);
  }

  void clocked() { last_ns_ = now_ns; }

 private:
  bool calibrates() const { return now_ns < calibrated_ns_; }

  uint8_t command(uint8_t in, double gap_us) {
    if (gap_us < wait_us_) ++misuse;  // t11
    wait_us_ = 4 * kClockUs;
    if ((in & 0xF0) == 0x50) {
      command_ = in, count_ = 1;
    } else if (in == 0x01) {
      output_ = static_cast<uint32_t>(result_) & 0xFFFFFF;
      answering_ = 3;
    } else if (in == 0xFC) {
      wait_us_ = 24 * kClockUs;
      synchronised_ = true, ready_ = false;
    } else if (in == 0xFF || in == 0x00) {
      if (synchronised_) converted_ns_ = now_ns + 1000u * kSettledUs, sampling_ = true;
      synchronised_ = false;
    } else if (in == 0xFE) {
      const uint8_t fresh[11] = {0x30, 0x01, 0x20, 0xF0, 0xE0, 0, 0, 0, 0, 0, 0};
      memcpy(registers, fresh, sizeof registers);
      calibrate();
    } else if (in == 0x0F) {
      // stops continuous reading, which it does not do
    } else {
      ++misuse;
    }
    return 0;
  }

  uint8_t argument(uint8_t in) {
    if (count_ == 1) {
      left_ = static_cast<uint8_t>(in + 1);
      count_ = 2;
      return 0;
    }
    const uint8_t number = static_cast<uint8_t>((command_ & 0x0F) + count_ - 2);
    if (number < 11) registers[number] = in;
    ++count_;
    if (--left_ == 0) {
      count_ = 0;
      const bool calibrating = number == 0 || number == 2 || number == 3;
      if (calibrating && (registers[0] & 0x04)) calibrate();
    }
    return 0;
  }

  void calibrate() {
    calibrated_ns_ = now_ns + 1000u * kCalibrationUs;
    converted_ns_ = calibrated_ns_ + 1000u * kSettledUs;
    ready_ = false, sampling_ = true;
  }

  void advance() {
    if (!sampling_ || now_ns < converted_ns_) return;
    const uint8_t mux = registers[1];
    const int64_t difference =
        static_cast<int64_t>(inputs[mux >> 4 & 7]) - inputs[mux & 7];
    const int shift = 6 - ((registers[2] & 7) > 6 ? 6 : (registers[2] & 7));
    result_ = static_cast<int32_t>(difference >> shift);
    ready_ = true, sampling_ = false;
  }

  uint64_t last_ns_ = 0, calibrated_ns_ = 0, converted_ns_ = 1000000;
  double wait_us_ = 0.0;
  bool ready_ = false, sampling_ = true, synchronised_ = false;
  uint8_t command_ = 0, count_ = 0, left_ = 0;
  int answering_ = 0;
  int32_t result_ = 0;
  uint32_t output_ = 0;
};

Ads1256 converter;
double bit_us = 1.0;

}  // namespace

UsbSerial Serial;
SpiBus SPI;

void pinMode(uint8_t pin, uint8_t mode) { modes[pin] = mode; }
void digitalWrite(uint8_t pin, uint8_t value) {
  if (modes[pin] != OUTPUT) ++violations;
  if (pin == kChipSelect && value == LOW) converter.select();
  pins[pin] = value;
}
uint8_t digitalReadFast(uint8_t pin) {
  now_ns += 100;
  if (pin != kDataReady) return pins[pin];
  return converter.ready() ? LOW : HIGH;
}
void analogWrite(uint8_t pin, int value) {
  if (value < 0 || value > 255) ++violations;
  power[pin] = value;
}
void analogWriteFrequency(uint8_t, float) {}
uint32_t micros() {
  now_ns += 100;
  return static_cast<uint32_t>(now_ns / 1000);
}
void delayMicroseconds(uint32_t duration_us) { now_ns += 1000ull * duration_us; }

void SpiBus::beginTransaction(const SPISettings& settings) {
  if (!begun || busy || settings.order != MSBFIRST || settings.mode != SPI_MODE1) ++violations;
  if (settings.hertz > 1920000) ++violations;  // t1: four periods of the clock
  busy = true;
  bit_us = 1e6 / settings.hertz;
}
uint8_t SpiBus::transfer(uint8_t out) {
  if (!busy || pins[kChipSelect] != LOW) ++violations;
  const uint8_t in = converter.transfer(out);
  now_ns += static_cast<uint64_t>(8e3 * bit_us);
  converter.clocked();
  return in;
}
void SpiBus::endTransaction() { busy = false; }

int32_t Encoder::read() { return encoder_counts[pin_]; }

void UsbSerial::begin(long) {}
int UsbSerial::available() { return static_cast<int>(received.size()); }
int UsbSerial::read() {
  const int byte = static_cast<uint8_t>(received[0]);
  received.erase(0, 1);
  return byte;
}
int UsbSerial::availableForWrite() { return static_cast<int>(room - sent.size()); }
size_t UsbSerial::write(const uint8_t* data, size_t length) {
  if (sent.size() + length > room) now_ns += 120000000ull;  // it waits for a computer that reads
  sent.append(reinterpret_cast<const char*>(data), length);
  return length;
}

#include "../teleop_rig/teleop_rig.ino"

extern "C" {

void sketch_setup() { setup(); }

void sketch_run(uint32_t duration_us) {
  const uint64_t until_ns = now_ns + 1000ull * duration_us;
  while (now_ns < until_ns) loop();
}

void sketch_receive(const uint8_t* data, size_t length) {
  Serial.received.append(reinterpret_cast<const char*>(data), length);
}

size_t sketch_sent(uint8_t* out, size_t room) {
  const size_t count = Serial.sent.size() < room ? Serial.sent.size() : room;
  memcpy(out, Serial.sent.data(), count);
  Serial.sent.erase(0, count);
  return count;
}

void sketch_set_input(uint8_t pin, int32_t counts) { converter.inputs[pin] = counts; }
void sketch_set_encoder(uint8_t pin, int32_t counts) { encoder_counts[pin] = counts; }
void sketch_unplug_converter() { converter.present = false; }

int sketch_power(uint8_t pwm, uint8_t forward, uint8_t backward) {
  return power[pwm] * (pins[forward] - pins[backward]);
}
uint8_t sketch_register(uint8_t number) { return converter.registers[number]; }
unsigned sketch_misuse() { return converter.misuse; }
unsigned sketch_violations() { return violations; }
uint64_t sketch_now_us() { return now_ns / 1000; }
}
