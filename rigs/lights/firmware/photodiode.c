/* Witness of a light: a photodiode on an Arduino Uno (ATmega328P, 16 MHz), its voltage on A0 (0 to 5 V, more is brighter).

   57600 baud, 8N1. Unasked, a hundred times a second:
     L SEQUENCE MILLISECONDS LEVEL CHECK
   SEQUENCE 0 to 65535; MILLISECONDS of the board's clock when the conversion began; LEVEL 0 to 1023 of 5 V; CHECK the
   CRC-8 (0x07) of all before the last space. "I" and a line feed -> "LIGHT 1.0", also said at every reset. It switches
   nothing, and nothing that is sent to it changes a reading.

   Build and flash: README.md */
#include <avr/interrupt.h>
#include <avr/io.h>

#define EVERY_MS 10

static volatile unsigned long milliseconds;
static volatile unsigned char asked; /* "I" has come; a line feed makes it a question */
static volatile unsigned char question;
static unsigned char crc;

ISR(TIMER1_COMPA_vect) { milliseconds++; }

ISR(USART_RX_vect) {
    unsigned char byte = UDR0;
    if (byte == '\n') { question |= asked; asked = 0; }
    else if (byte != '\r') asked = byte == 'I';
}

static void put(char byte) {
    while (!(UCSR0A & (1 << UDRE0))) {}
    UDR0 = byte;
    crc ^= byte;
    for (unsigned char bit = 0; bit < 8; bit++) crc = crc & 0x80 ? crc << 1 ^ 0x07 : crc << 1;
}

static void say(const char *text) { for (; *text; text++) put(*text); }

static void say_number(unsigned long number) {
    char digits[10];
    unsigned char length = 0;
    do digits[length++] = '0' + number % 10; while (number /= 10);
    while (length) put(digits[--length]);
}

static unsigned long now(void) {
    cli();
    unsigned long at = milliseconds;
    sei();
    return at;
}

static unsigned int level(void) {
    ADCSRA |= 1 << ADSC;
    while (ADCSRA & (1 << ADSC)) {}
    return ADC;
}

static void say_reading(unsigned int sequence, unsigned long at, unsigned int reading) {
    crc = 0;
    say("L ");
    say_number(sequence);
    put(' ');
    say_number(at);
    put(' ');
    say_number(reading);
    unsigned char check = crc;
    put(' ');
    put("0123456789ABCDEF"[check >> 4]);
    put("0123456789ABCDEF"[check & 15]);
    put('\n');
}

int main(void) {
    unsigned int sequence = 0;
    unsigned long last = 0;
    ADMUX = 1 << REFS0;                                                 /* reference AVCC, channel 0 */
    ADCSRA = (1 << ADEN) | (1 << ADPS2) | (1 << ADPS1) | (1 << ADPS0); /* 125 kHz: 0.1 ms a conversion */
    UCSR0A = 1 << U2X0;
    UBRR0 = 34; /* 57143 baud, 0.8 % slow */
    UCSR0B = (1 << RXEN0) | (1 << TXEN0) | (1 << RXCIE0);
    UCSR0C = 3 << UCSZ00;
    TCCR1B = (1 << WGM12) | (1 << CS11) | (1 << CS10); /* clear on match, clock / 64 */
    OCR1A = 249;                                       /* 1 kHz */
    TIMSK1 = 1 << OCIE1A;
    sei();
    say("LIGHT 1.0\n");
    for (;;) {
        if (question) {
            question = 0;
            say("LIGHT 1.0\n");
        }
        unsigned long at = now();
        if (at - last < EVERY_MS) continue;
        last = at;
        say_reading(sequence++, at, level());
    }
}
