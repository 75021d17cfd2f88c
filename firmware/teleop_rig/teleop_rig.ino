// A rig on a Teensy 4: two DC motors with encoders, four load cells on an ADS1256.
// Libraries: Encoder (Paul Stoffregen). Wiring and settings: docs/how-to/rigs.md.
#include <Encoder.h>
#include <SPI.h>

#include "controller.h"

using namespace teleop_rig;

constexpr uint8_t kMotors = 2, kCells = 2;
constexpr uint16_t kRateHz = 1000;
constexpr uint8_t kPwm[kMotors] = {22, 23}, kIn1[kMotors] = {14, 16}, kIn2[kMotors] = {15, 17};
constexpr uint8_t kCs = 10, kDrdy = 9;
constexpr uint32_t kReadyUs = 5000;  // in which the converter has calibrated itself
constexpr float kGain = 0.004f, kDamping = 0.00008f;  // [1/count], [s/count] of the position loops
constexpr float kMost = 0.5f;                         // of full power; begin low

Encoder encoders[kMotors] = {Encoder(2, 3), Encoder(4, 5)};
const SPISettings kSpi(1900000, MSBFIRST, SPI_MODE1);

class TeensyBoard : public Board {
 public:
  const char* name() const override { return "teensy4 ads1256"; }
  uint8_t motors() const override { return kMotors; }
  uint8_t cells() const override { return kCells; }
  uint16_t rate_hz() const override { return kRateHz; }
  uint32_t micros() override { return ::micros(); }
  int32_t position(uint8_t motor) override { return encoders[motor].read(); }
  int32_t cell(uint8_t cell) override { return cells_[cell]; }
  bool motor_fault() override { return false; }  // read the bridge's fault pin here, if it has one
  bool cell_fault() override { return ::micros() - converted_us_ > 20000; }
  // A computer that does not read must not hold up the watchdog: `write` waits 120 ms for room.
  void send(const uint8_t* data, size_t length) override {
    if (Serial.availableForWrite() >= static_cast<int>(length)) Serial.write(data, length);
  }

  void enable(uint8_t motor, bool on) override {
    enabled_[motor] = on;
    targets_[motor] = encoders[motor].read();
    last_[motor] = targets_[motor];
    if (!on) drive(motor, 0.0f);
  }
  void move_to(uint8_t motor, int32_t target) override { targets_[motor] = target; }

  void begin() {
    for (uint8_t i = 0; i < kMotors; ++i) {
      pinMode(kIn1[i], OUTPUT);
      pinMode(kIn2[i], OUTPUT);
      analogWriteFrequency(kPwm[i], 20000);
      drive(i, 0.0f);
    }
    pinMode(kCs, OUTPUT);
    digitalWrite(kCs, HIGH);
    pinMode(kDrdy, INPUT_PULLUP);  // without a converter it is never ready
    SPI.begin();
    command(0xFE);            // RESET, after which it calibrates itself
    write_register(0, 0x06);  // STATUS: calibrates itself at each change below; input buffer on
    write_register(2, 0x06);  // ADCON: gain 64
    write_register(3, 0xF0);  // DRATE: 30 kSPS; 4374 a second when the input changes each time
    for (uint8_t i = 0; i < kCells; ++i) cells_[i] = kMissing;
  }

  // Reads a finished conversion and starts that of the next cell; true once all have been read.
  bool convert() {
    if (digitalReadFast(kDrdy)) return false;
    const uint8_t next = static_cast<uint8_t>((cell_ + 1) % kCells);
    SPI.beginTransaction(kSpi);
    digitalWriteFast(kCs, LOW);
    SPI.transfer(0x51);  // WREG MUX
    SPI.transfer(0x00);
    SPI.transfer(static_cast<uint8_t>((2 * next) << 4 | (2 * next + 1)));
    delayMicroseconds(1);
    SPI.transfer(0xFC);  // SYNC
    delayMicroseconds(4);
    SPI.transfer(0xFF);  // WAKEUP
    delayMicroseconds(1);
    SPI.transfer(0x01);  // RDATA of the conversion before
    delayMicroseconds(7);
    uint32_t raw = 0;
    for (int k = 0; k < 3; ++k) raw = raw << 8 | SPI.transfer(0xFF);
    digitalWriteFast(kCs, HIGH);
    SPI.endTransaction();
    cells_[cell_] = static_cast<int32_t>(raw << 8) >> 8;
    converted_us_ = ::micros();
    cell_ = next;
    return cell_ == 0;
  }

  // Position loops, called every millisecond.
  void move() {
    for (uint8_t i = 0; i < kMotors; ++i) {
      const int32_t now = encoders[i].read();
      const float speed = static_cast<float>(now - last_[i]) * kRateHz;
      last_[i] = now;
      if (enabled_[i]) drive(i, kGain * static_cast<float>(targets_[i] - now) - kDamping * speed);
    }
  }

 private:
  void drive(uint8_t motor, float power) {
    power = power > kMost ? kMost : power < -kMost ? -kMost : power;
    digitalWriteFast(kIn1[motor], power > 0.0f);
    digitalWriteFast(kIn2[motor], power < 0.0f);
    analogWrite(kPwm[motor], static_cast<int>(255.0f * (power < 0.0f ? -power : power)));
  }
  void command(uint8_t code) {
    wait_ready();
    SPI.beginTransaction(kSpi);
    digitalWriteFast(kCs, LOW);
    SPI.transfer(code);
    delayMicroseconds(5);
    digitalWriteFast(kCs, HIGH);
    SPI.endTransaction();
  }
  void write_register(uint8_t number, uint8_t value) {
    wait_ready();
    SPI.beginTransaction(kSpi);
    digitalWriteFast(kCs, LOW);
    SPI.transfer(static_cast<uint8_t>(0x50 | number));
    SPI.transfer(0x00);
    SPI.transfer(value);
    delayMicroseconds(5);
    digitalWriteFast(kCs, HIGH);
    SPI.endTransaction();
  }

  // While it calibrates itself, the converter takes no command; none is waited for longer than that.
  void wait_ready() {
    const uint32_t since_us = ::micros();
    while (digitalReadFast(kDrdy) && ::micros() - since_us < kReadyUs) {
    }
  }

  bool enabled_[kMotors] = {};
  int32_t targets_[kMotors] = {}, last_[kMotors] = {}, cells_[kCells] = {};
  uint8_t cell_ = 0;
  uint32_t converted_us_ = 0;
};

TeensyBoard board;
Controller controller(board);
uint32_t due_us = 0;

void setup() {
  Serial.begin(2000000);
  board.begin();
  due_us = micros();
}

void loop() {
  while (Serial.available()) controller.receive(static_cast<uint8_t>(Serial.read()));
  controller.check_watchdog();
  board.convert();
  if (static_cast<int32_t>(micros() - due_us) < 0) return;
  due_us += 1000000 / kRateHz;
  board.move();
  controller.sample(micros());
}
