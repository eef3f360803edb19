// The little of Arduino's core that the vendor's library asks for where a port handler of one's own is used.
#ifndef ARDUINO_H_
#define ARDUINO_H_

#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>

#define OUTPUT 1
#define HIGH 1
#define LOW 0

unsigned long millis();
unsigned long micros();
inline void delay(unsigned long) {}
inline void delayMicroseconds(unsigned int) {}
inline void pinMode(int, int) {}
inline void digitalWrite(int, int) {}
inline int digitalRead(int) { return 0; }

class HardwareSerial {
 public:
  void begin(unsigned long) {}
  void end() {}
  int available() { return 0; }
  int read() { return -1; }
  void flush() {}
  size_t write(uint8_t) { return 1; }
  size_t write(uint8_t *, size_t size) { return size; }
  operator bool() { return true; }
};

#endif
