// The part of the Teensy's Arduino core that the sketch uses, on a computer: pins, time, USB serial.
#pragma once
#include <stddef.h>
#include <stdint.h>

#include <string>

constexpr uint8_t OUTPUT = 1, INPUT = 0, INPUT_PULLUP = 2, HIGH = 1, LOW = 0, MSBFIRST = 1;

void pinMode(uint8_t pin, uint8_t mode);
void digitalWrite(uint8_t pin, uint8_t value);
inline void digitalWriteFast(uint8_t pin, uint8_t value) { digitalWrite(pin, value); }
uint8_t digitalReadFast(uint8_t pin);
void analogWrite(uint8_t pin, int value);
void analogWriteFrequency(uint8_t pin, float hertz);
uint32_t micros();
void delayMicroseconds(uint32_t duration_us);

struct UsbSerial {
  void begin(long baud);
  int available();
  int read();
  int availableForWrite();
  size_t write(const uint8_t* data, size_t length);

  std::string received, sent;  // from the computer, and to it
  size_t room = 8192;          // [B] until the computer reads
};
extern UsbSerial Serial;
